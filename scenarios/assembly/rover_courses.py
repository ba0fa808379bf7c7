"""Where a rover is to drive: the path of R's origin from W's origin, heading along x."""

from __future__ import annotations

import math

from controllers.path import Path, Segment, arc, line
from scenarios.options.rover import RoverArcOptions, RoverCourse, RoverStraightOptions
from vehicle.frames import Pose2

_RAMP = 0.3  # of curvature into a circle: 4 s at 8 cm/s, in which the wheels are turned [m]


def rover_path(options: RoverCourse) -> Path:
    """The path of a course."""
    start = Pose2(0.0, 0.0, 0.0)
    if isinstance(options, RoverStraightOptions):
        return Path(start, (line(options.length),))
    if isinstance(options, RoverArcOptions):
        return Path(start, (line(options.straight), *_turn(options.radius, math.radians(options.turn_deg))))
    circle = 2.0 * math.pi
    eight = (*_turn(options.radius, circle), *_turn(options.radius, -circle))
    return Path(start, (line(options.straight), *eight, line(options.straight)))


def _turn(radius: float, turn: float) -> tuple[Segment, ...]:
    """Into a circle, round and out of it, by ``turn`` [rad] in all; the ramps take their part of it."""
    curvature = math.copysign(1.0 / radius, turn)
    ramp = min(_RAMP, 0.5 * radius * abs(turn))
    round_it = radius * abs(turn) - ramp
    middle = (arc(round_it, curvature),) if round_it > 1e-9 else ()
    return (Segment(ramp, 0.0, curvature), *middle, Segment(ramp, curvature, 0.0))
