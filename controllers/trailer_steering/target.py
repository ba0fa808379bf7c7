"""The path at the follow point: what trailer steering laws steer towards."""

from __future__ import annotations

from typing import NamedTuple

from controllers.trailer_steering.kinematics import limited_direction
from estimators.off_tracking.hitch_path import crossing, tangent
from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_REACH = 0.75  # half window of the fit to the path at the follow point [m]


class Target(NamedTuple):
    """The path at the follow point, in the trailer's frame."""

    offset: float  # + when it lies left [m]
    direction: float  # + left [rad]
    curvature: float  # + left [1/m]


def target_on(path: FloatArray, follow_distance: float) -> Target | None:
    """The point of a path (n, 2), newest first, at the follow point; None if it does not reach back that far."""
    s = arc_length(path)
    passed = crossing(path, s, -follow_distance)
    if passed is None:
        return None
    tangent_there = tangent(path, s, passed.s, _REACH)
    return Target(passed.y, limited_direction(tangent_there.direction), tangent_there.curvature)
