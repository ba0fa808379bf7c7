"""Brake systems switched by a scenario's keys."""

from __future__ import annotations

import pytest

from scenarios.assembly.adapters import plant_vehicle, vehicle_of
from scenarios.options.scenario import Scenario, load_scenario


def loaded(vehicle: str, *settings: str) -> Scenario:
    return load_scenario("roundabout", [f"vehicle={vehicle}", *settings])


def test_brake_systems_are_switched_off_in_the_simulated_vehicle() -> None:
    without_abs = plant_vehicle(loaded("eu_tractor_semitrailer", "brakes.abs=false"))
    assert without_abs.brakes is not None
    assert not without_abs.brakes.abs
    without_control = plant_vehicle(loaded("eu_tractor_semitrailer", "brakes.traction_control=false"))
    assert without_control.powertrain is not None
    assert not without_control.powertrain.traction_control
    unchanged = loaded("eu_tractor_semitrailer")
    assert plant_vehicle(unchanged) == vehicle_of(unchanged)


def test_a_vehicle_without_brake_data_has_no_abs() -> None:
    bare = loaded("mobile_crane_5_axle", "brakes.abs=false")
    assert plant_vehicle(bare) == vehicle_of(bare)
    with pytest.raises(ValueError, match=r"brakes.abs = true: the file of vehicle mobile_crane_5_axle has no table"):
        plant_vehicle(loaded("mobile_crane_5_axle", "brakes.abs=true"))
