"""Brake systems switched by a scenario's keys."""

from __future__ import annotations

import pytest

from scenarios.assembly.plants import plant_vehicle
from scenarios.options.scenario import load_scenario
from vehicle.combination.description import load_vehicle


def test_abs_is_switched_off_in_the_simulated_vehicle() -> None:
    vehicle = load_vehicle("eu_tractor_semitrailer")
    changed = plant_vehicle(load_scenario("roundabout", ["brakes.abs=false"]), vehicle)
    assert changed.brakes is not None
    assert not changed.brakes.abs
    assert plant_vehicle(load_scenario("roundabout"), vehicle) == vehicle


def test_a_vehicle_without_brake_data_has_no_abs() -> None:
    bare = load_vehicle("eu_tractor_semitrailer").model_copy(update={"brakes": None})
    assert plant_vehicle(load_scenario("roundabout", ["brakes.abs=false"]), bare) == bare
    with pytest.raises(ValueError, match=r"brakes.abs = true: the file of vehicle eu_tractor_semitrailer has no table"):
        plant_vehicle(load_scenario("roundabout", ["brakes.abs=true"]), bare)


def test_traction_control_is_switched_off_in_the_simulated_vehicle() -> None:
    vehicle = load_vehicle("eu_tractor_semitrailer")
    changed = plant_vehicle(load_scenario("roundabout", ["brakes.traction_control=false"]), vehicle)
    assert changed.powertrain is not None
    assert not changed.powertrain.traction_control
