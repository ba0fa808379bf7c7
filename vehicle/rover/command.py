"""What a rover can be told to do; its wheels in their order."""

from __future__ import annotations

from typing import Final, NamedTuple

WHEELS: Final = ("front_left", "front_right", "rear_left", "rear_right")
REAR_LEFT: Final = 2


class RoverCommand(NamedTuple):
    """Demands of one control step, by wheel."""

    wheel_speed: tuple[float, float, float, float]  # of rotation, + forward [rad/s]
    steer: tuple[float, float, float, float]  # against the body, + left; a wheel that can not be steered has 0 [rad]
