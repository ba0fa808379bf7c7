"""The model's static rollover against the minimum of the potential energy."""

from __future__ import annotations

import pytest

from offtrack.studies.validation.rollover_checks import rollover_by_energy
from vehicle.combination.description import load_vehicle
from vehicle.combination.roll import static_rollover
from vehicle.combination.variants import with_load


@pytest.mark.parametrize("load", ["full", "half"])
@pytest.mark.parametrize("name", ["us_5_axle", "b_double", "a_double", "rigid_truck_8x4", "desaxe_field_combination"])
def test_the_equations_of_roll_tip_where_the_energy_loses_its_minimum(name: str, load: str) -> None:
    """Finite angles, tyres that only push, and loads by moments: 2 % for the model's small angles."""
    vehicle = with_load(load_vehicle(name), load)
    assert static_rollover(vehicle).threshold == pytest.approx(rollover_by_energy(vehicle), rel=0.02)
