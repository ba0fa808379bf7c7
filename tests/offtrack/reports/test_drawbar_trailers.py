"""Default steering laws on short drawbar trailers: no weaving on the straight after a turn."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.driver import PreviewDriver
from offtrack.studies.standards.proving_ground import drive
from scenarios.assembly.adapters import tractor_guided_at
from scenarios.courses import Turn, turns
from tests.drawbar_trailers import centre_axle, full_trailer
from vehicle.combination.description import Vehicle
from vehicle.surface import Surface


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "law", "kmh"),
    [
        (centre_axle(2.0), "path_preview", 10.0),  # 17 deg/s of yaw rate with the gains of a semi-trailer
        (centre_axle(3.0), "path_preview", 15.0),  # 11 deg/s
        (centre_axle(8.0, 3), "path_preview", 10.0),  # 3 deg/s
        (full_trailer(4.0), "path_preview", 15.0),
        (centre_axle(8.0, 3), "path_preview", 25.0),  # 11 deg/s with a quick filter of the slip
        (centre_axle(8.0, 3), "virtual_driver", 40.0),  # 80 deg/s, steer at its rate limit, with a constant gain
        (full_trailer(5.0, 2), "virtual_driver", 60.0),  # 110 deg/s
    ],
    ids=["2 m", "3 m", "8 m", "full", "8 m fast", "driver", "driver on a full trailer"],
)
def test_a_short_trailer_does_not_weave_after_a_turn(vehicle: Vehicle, law: str, kmh: float) -> None:
    """In the last 4 s the yaw rate only settles: to and fro it changes by less than 1 deg/s in all.

    Weaving at 1.3 Hz with 5 deg/s from side to side makes 50 deg/s.
    """
    speed, tractor = kmh / 3.6, vehicle.units[0]
    radius = max(13.0, speed**2 / 1.5)  # 0.15 g at most
    sequence = [Turn("left", radius, max(1.0, 4.0 * speed / radius), 12.0 * speed)]
    course = turns(front_x=tractor.front_x, width=tractor.width, sequence=sequence, entry=15.0)
    end = course.path.knots[-1]
    driven = drive(
        vehicle,
        Surface(friction=0.8),
        PreviewDriver(tractor_guided_at(vehicle, course.reference), course.path, speed),
        trailer_steering=law,
        speed=speed,
        done=lambda truth: math.hypot(truth.poses[0, 0] - end.x, truth.poses[0, 1] - end.y) < tractor.front_x + 1.0,
        patience=3.0 * course.length / speed,
    )
    assert driven.outcome == "completed"
    yaw_rate = driven.log[f"yaw_rate_{vehicle.units[-1].name}"][driven.log["time"] > driven.log["time"][-1] - 4.0]
    assert np.abs(np.diff(yaw_rate)).sum() - abs(yaw_rate[-1] - yaw_rate[0]) < math.radians(1.0)
