"""Wheels of a rover as its software knows them, and the command to them."""

from typing import NamedTuple


class WheelPlace(NamedTuple):
    """Name and place of a wheel."""

    name: str
    x: float  # in R, + ahead of the body centre [m]
    y: float  # in R, + left [m]


class RoverCommand(NamedTuple):
    """Demands of one control step, by wheel."""

    wheel_speed: tuple[float, ...]  # of rotation, + forward [rad/s]
    steer: tuple[float, ...]  # against the body, + left; 0 for a wheel without steering [rad]


def corner_wheels(wheelbase: float, tread: float) -> tuple[WheelPlace, ...]:
    """Four wheels at the corners of a rectangle [m] around R's origin."""
    a, b = 0.5 * wheelbase, 0.5 * tread
    corners = (("front_left", a, b), ("front_right", a, -b), ("rear_left", -a, b), ("rear_right", -a, -b))
    return tuple(WheelPlace(*corner) for corner in corners)
