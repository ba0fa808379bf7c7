"""Courses of rovers: each kind is a table of options that builds its path. A new kind is a class and a line."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Final, Literal, Union

from pydantic import Field

from controllers.path import Path, Segment, arc, line
from scenarios.options.base import Options, option, quantity
from vehicle.frames import Pose2

_START: Final = Pose2(0.0, 0.0, 0.0)
_RAMP: Final = 0.3  # of curvature into a circle: 4 s at 8 cm/s, in which the wheels are turned [m]


class RoverCourseOptions(Options):
    """Base class of all courses; one's own is named by ``course.kind = package.module:Name``."""

    kind: str = option("Kind of the path (see offtrack parts rover_course) or package.module:Name.")

    def path(self) -> Path:
        """Path of R's origin from W's origin, heading along x."""
        raise ValueError(f"course.kind = {self.kind}: the class does not say how its path is built")


class RoverStraightOptions(RoverCourseOptions):
    """Straight ahead."""

    kind: Literal["straight"] = option("Kind of the path.")
    length: float = quantity(7.0, "m", 0.5, 200.0, "Length of the path; Reina 2008, section III: about 7 m.")

    def path(self) -> Path:
        """Path of R's origin from W's origin, heading along x."""
        return Path(_START, (line(self.length),))


class RoverFigureOfEightOptions(RoverCourseOptions):
    """A full left circle, then a full right circle, a straight before and after."""

    kind: Literal["figure-of-eight"] = option("Kind of the path.")
    radius: float = quantity(2.0, "m", 1.0, 50.0, "Radius of both circles.")
    straight: float = quantity(1.0, "m", 0.2, 50.0, "Straight before and after the circles.")

    def path(self) -> Path:
        """Path of R's origin from W's origin, heading along x."""
        eight = (*_turn(self.radius, math.tau), *_turn(self.radius, -math.tau))
        return Path(_START, (line(self.straight), *eight, line(self.straight)))


class RoverArcOptions(RoverCourseOptions):
    """A straight, then an arc to the left (turn > 0) or to the right."""

    kind: Literal["arc"] = option("Kind of the path.")
    radius: float = quantity(3.0, "m", 1.0, 100.0, "Radius of the arc.")
    turn_deg: float = quantity(90.0, "deg", -720.0, 720.0, "Angle of the arc, + left.")
    straight: float = quantity(1.0, "m", 0.2, 50.0, "Straight before the arc.")

    def path(self) -> Path:
        """Path of R's origin from W's origin, heading along x."""
        return Path(_START, (line(self.straight), *_turn(self.radius, math.radians(self.turn_deg))))


def _turn(radius: float, turn: float) -> tuple[Segment, ...]:
    """Into a circle, round and out of it, by ``turn`` [rad] in all; the ramps take their part of it."""
    curvature = math.copysign(1.0 / radius, turn)
    ramp = min(_RAMP, 0.5 * radius * abs(turn))
    round_it = radius * abs(turn) - ramp
    middle = (arc(round_it, curvature),) if round_it > 1e-9 else ()
    return (Segment(ramp, 0.0, curvature), *middle, Segment(ramp, curvature, 0.0))


ROVER_COURSES: Final = (RoverStraightOptions, RoverFigureOfEightOptions, RoverArcOptions)
if TYPE_CHECKING:
    RoverCourseTable = RoverCourseOptions
else:
    RoverCourseTable = Annotated[Union[ROVER_COURSES], Field(discriminator="kind")]  # noqa: UP007  # of a tuple
