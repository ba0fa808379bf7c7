"""Default steering laws on short drawbar trailers: no weaving on the straight after a turn."""

import math

import numpy as np
import pytest

from controllers.driver import PreviewDriver
from offtrack.studies.standards.proving_ground import drive
from scenarios.assembly.adapters import tractor_guided_at
from scenarios.courses import Turn, turns
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.unit import Steering, Unit
from vehicle.surface import Surface

_SPACING = 1.31  # of axles [m]
_AXLE_LOAD = 8000.0  # [kg]
_DRAWBAR = 3.0  # of the dolly: eye to axle [m]


def centre_axle(length: float, axles: int = 1) -> Vehicle:
    """Rigid truck and a trailer whose steered axles are ``length`` [m] behind the eye on average."""
    return _towed("centre_axle", _body("trailer", length, axles, ahead=0.4, load=0.97))


def full_trailer(length: float, axles: int = 1) -> Vehicle:
    """Rigid truck, dolly, and a body whose steered axles are ``length`` [m] behind the turntable on average."""
    body = _body("body", length, axles, ahead=-1.0, load=0.55)
    axle = body.axles[0].model_copy(update={"x": -_DRAWBAR, "steered": False})
    dolly = body.model_copy(
        update={
            "name": "dolly", "mass": 1500.0, "yaw_inertia": 1500.0, "cg_x": -0.9 * _DRAWBAR, "cg_height": 0.9,
            "front_x": -_DRAWBAR + 0.9, "rear_x": -_DRAWBAR - 0.9, "height": 1.2, "hitch_x": -_DRAWBAR,
            "hitch_height": 1.1, "follow_x": None, "steering": None, "axles": (axle,),
        }
    )  # fmt: skip
    return _towed("full_trailer", dolly, body)


def _towed(name: str, *towed: Unit) -> Vehicle:
    truck, drive = load_vehicle("rigid_truck").units[0], load_vehicle("rigid_truck").drive
    truck = truck.model_copy(update={"hitch_x": truck.rear_x, "hitch_height": 0.7})
    return Vehicle(name=name, drive=drive, units=(truck, *towed))


def _body(name: str, length: float, axles: int, *, ahead: float, load: float) -> Unit:
    """A laden body; ``ahead`` is from the hitch to its front end, ``load`` its share of the mass on its own axles."""
    semi = load_vehicle("uk_longer_semitrailer").units[1]
    steered = next(axle for axle in semi.axles if axle.steered)
    steered = steered.model_copy(update={"steered": True, "ackermann_x": None, "steer_group": None})
    mass, first = _AXLE_LOAD * axles / load, length - 0.5 * _SPACING * (axles - 1)
    places = [first + _SPACING * k for k in range(axles)]
    rear = places[-1] + 1.5
    front = -1.0 if ahead < 0.0 else max(0.5, 0.3 * length)
    return semi.model_copy(
        update={
            "name": name, "mass": mass, "yaw_inertia": mass * (rear - front) ** 2 / 12.0, "cg_x": -load * length,
            "cg_height": 1.7, "front_x": -front, "rear_x": -rear, "hitch_x": None, "hitch_height": None,
            "follow_x": -rear, "payload": None, "steering": Steering(lag=0.15, limit_deg=30.0, rate_limit_deg=20.0),
            "axles": tuple(steered.model_copy(update={"x": -place}) for place in places),
        }
    )  # fmt: skip


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
