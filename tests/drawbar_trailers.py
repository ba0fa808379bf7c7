"""Combinations with short steered trailers: a centre-axle trailer, and a full trailer of a dolly and a body."""

from __future__ import annotations

from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.unit import Axle, Steering, Unit

_SPACING = 1.31  # of axles [m]
_AXLE_LOAD = 8000.0  # [kg]
_DRAWBAR = 3.0  # of the dolly: eye to axle [m]


def centre_axle(length: float, axles: int = 1) -> Vehicle:
    """Rigid truck and a trailer whose steered axles are ``length`` [m] behind the eye on average."""
    truck, trailer = _truck(), _body("trailer", length, axles, ahead=0.4, load=0.97)
    return Vehicle(name="centre_axle", drive=load_vehicle("rigid_truck").drive, units=(truck, trailer))


def full_trailer(length: float, axles: int = 1) -> Vehicle:
    """Rigid truck, dolly, and a body whose steered axles are ``length`` [m] behind the turntable on average."""
    body = _body("body", length, axles, ahead=-1.0, load=0.55)
    axle = body.axles[0].model_copy(update={"x": -_DRAWBAR, "steered": False})
    dolly = body.model_copy(
        update={
            "name": "dolly",
            "mass": 1500.0,
            "yaw_inertia": 1500.0,
            "cg_x": -0.9 * _DRAWBAR,
            "cg_height": 0.9,
            "front_x": -_DRAWBAR + 0.9,
            "rear_x": -_DRAWBAR - 0.9,
            "height": 1.2,
            "hitch_x": -_DRAWBAR,
            "hitch_height": 1.1,
            "follow_x": None,
            "steering": None,
            "axles": (axle,),
        }
    )
    drive = load_vehicle("rigid_truck").drive
    return Vehicle(name="full_trailer", drive=drive, units=(_truck(), dolly, body))


def _truck() -> Unit:
    truck = load_vehicle("rigid_truck").units[0]
    return truck.model_copy(update={"hitch_x": truck.rear_x, "hitch_height": 0.7})


def _body(name: str, length: float, axles: int, *, ahead: float, load: float) -> Unit:
    """A laden body; ``ahead`` is from the hitch to its front end, ``load`` its share of the mass on its own axles."""
    semi = load_vehicle("uk_longer_semitrailer").units[1]
    steered = next(axle for axle in semi.axles if axle.steered)
    mass, first = _AXLE_LOAD * axles / load, length - 0.5 * _SPACING * (axles - 1)
    places = [first + _SPACING * k for k in range(axles)]
    rear = places[-1] + 1.5
    front = -1.0 if ahead < 0.0 else max(0.5, 0.3 * length)
    body_length = rear - front
    return semi.model_copy(
        update={
            "name": name,
            "mass": mass,
            "yaw_inertia": mass * body_length**2 / 12.0,
            "cg_x": -load * length,
            "cg_height": 1.7,
            "front_x": -front,
            "rear_x": -rear,
            "hitch_x": None,
            "hitch_height": None,
            "follow_x": -rear,
            "payload": None,
            "steering": Steering(lag=0.15, limit_deg=30.0, rate_limit_deg=20.0),
            "axles": tuple(_axle(steered, -place) for place in places),
        }
    )


def _axle(axle: Axle, x: float) -> Axle:
    return axle.model_copy(update={"x": x, "steered": True, "ackermann_x": None, "steer_group": None})
