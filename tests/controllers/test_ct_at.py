"""Heading-based path following of Jujnovich and Cebon's kind."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer import Combination
from controllers.trailer_steering.signal_laws import CtAt
from scenarios.courses import roundabout, straight
from tests.trailers import ALL_STEERED as TRAILER
from vehicle.combination.description import load_vehicle

LOADED = load_vehicle("uk_longer_semitrailer")
TRACTOR = LOADED.units[0].model_copy(update={"hitch_x": 0.6})  # that of `drive`
COMBINATION = Combination(LOADED.model_copy(update={"units": (TRACTOR, *LOADED.units[1:])}), 1)
ROUNDABOUT = roundabout(front_x=5.2, width=2.55)


def test_without_slip_the_follow_point_keeps_to_the_path(drive: Any) -> None:
    """Unsteered, it would be 5 m off. 0.1 m is what path-following control aims at (de Saxe 2018, 2)."""
    run = drive(ROUNDABOUT, TRAILER, CtAt(TRAILER, combination=COMBINATION))
    assert run.rms < 0.06
    assert run.worst < 0.10


def test_slip_leaves_a_steady_error_that_the_heading_can_not_show(drive: Any) -> None:
    """Straight on a cross-fall, axles slipping by s turn the rear by s L_f/x_c beside what was asked for.

    A heading error e/L_f times the gain K balances it: e = -s L_f (L_f/x_c)/K, with x_c = sum(x^2)/sum(x).
    """
    slip, gain = -math.radians(1.0), 1.5
    run = drive(
        straight(front_x=5.2, length=160.0),
        TRAILER,
        CtAt(TRAILER, combination=COMBINATION, parameters=CtAt.Parameters(heading_gain=gain)),
        slip=lambda lateral_acceleration: slip,
    )
    assert abs(run.off_tracking[-1]) > 0.1  # the known weakness of the scheme
    distances = np.array(TRAILER.axle_distances)
    x_c = float(distances @ distances) / float(distances.sum())
    assert run.off_tracking[-1] == pytest.approx(-slip * 14.0 * (14.0 / x_c) / gain, rel=0.01)  # tangents for angles


def test_the_reference_trailer_brings_the_rear_back_after_saturation(drive: Any) -> None:
    """Axles that get no farther than 12 deg lose the path in the circle; heading alone would not find it again."""
    short = replace(TRAILER, max_steer=math.radians(12.0))
    course = roundabout(front_x=5.2, width=2.55, turn=0.25 * math.tau, exit=75.0)
    with_reference = drive(course, short, CtAt(short, combination=COMBINATION))
    without = drive(course, short, CtAt(short, combination=COMBINATION, parameters=CtAt.Parameters(heading_gain=0.0)))
    assert with_reference.worst > 0.3  # it was saturated
    assert abs(with_reference.off_tracking[-1]) < 0.05
    assert abs(without.off_tracking[-1]) > 0.3


def test_left_and_right_are_steered_alike(drive: Any) -> None:
    """Mirror symmetry of the whole loop."""
    law = CtAt(TRAILER, combination=COMBINATION)
    left = drive(ROUNDABOUT, TRAILER, law, until=20.0)
    right = drive(roundabout(front_x=5.2, width=2.55, direction="right"), TRAILER, law, until=20.0)
    np.testing.assert_allclose(right.steer, -left.steer, atol=1e-6)  # roundings, as the loop forgets them
