"""Full brake applications of the assessment."""

from __future__ import annotations

import math

import pytest

from offtrack.studies.standards.comparison import judged
from offtrack.studies.standards.full_braking import braking, braking_in_turn, braking_slippery, braking_split
from offtrack.studies.standards.proving_ground import Conditions
from offtrack.studies.validation.stopping_checks import without_abs
from vehicle.combination.description import Vehicle, load_vehicle


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("eu_tractor_semitrailer")


def test_a_dry_stop_meets_the_type_0_test(vehicle: Vehicle) -> None:
    """From 60 km/h: 5 m/s2 and 36.7 m at least by UN R13; the distance is v t + v^2 / (2 a)."""
    figures = braking(vehicle).figures
    slowing, distance = figures["braking_mean_deceleration_m_s2"], figures["braking_distance_m"]
    assert 5.0 < slowing < 0.8 * 9.81
    v = 60.0 / 3.6
    assert v**2 / (2.0 * slowing) < distance < v * 0.4 + v**2 / (2.0 * slowing)
    assert {judgement.reached for judgement in judged(figures)} == {"met"}


def test_distances_grow_as_friction_falls(vehicle: Vehicle) -> None:
    slippery = braking_slippery(vehicle).figures
    assert slippery["braking_slippery_mean_deceleration_m_s2"] == pytest.approx(0.3 * 9.81, rel=0.06)
    ice = braking_slippery(vehicle, "none", Conditions(friction=0.15)).figures
    ratio = ice["braking_slippery_distance_m"] / slippery["braking_slippery_distance_m"]
    assert ratio == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("hand", ["left", "right"])
def test_split_friction_is_steered_out(vehicle: Vehicle, hand: str) -> None:
    """The driver stays within 10 cm of the line, more slowly than on dry road, faster than on ice alone."""
    figures = braking_split(vehicle, "none", Conditions(hand="left" if hand == "left" else "right")).figures
    assert figures["braking_split_path_error_m"] < 0.1
    assert figures["braking_split_articulation_rad"] < math.radians(3.0)
    assert 0.2 * 9.81 < figures["braking_split_mean_deceleration_m_s2"] < 0.5 * 9.81


def test_it_keeps_its_lane_in_the_turn_with_abs_only(vehicle: Vehicle) -> None:
    """A lane of 12 ft on a curve of 500 ft, as FMVSS 121 asks of tractors."""
    held = braking_in_turn(vehicle).figures
    assert held["braking_lane_m"] < 12.0 * 0.3048
    assert held["braking_in_turn_articulation_rad"] < math.radians(6.0)
    folded = braking_in_turn(without_abs(vehicle)).figures
    assert folded["braking_lane_m"] > 12.0 * 0.3048
    assert folded["braking_in_turn_articulation_rad"] > math.radians(45.0)
