"""Courses of rovers: each kind is a table that builds its path. Add new kinds to ``ROVER_COURSES``."""

import math
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Annotated, Final, Literal, Union

from pydantic import Field

from controllers.path import Path, Segment, arc, line
from scenarios.options.base import FullPath, Word
from scenarios.roads.fitted_path import Fit, fitted_path, near
from scenarios.roads.path_file import TRACK, read_path
from vehicle.foundation.quantity import Frozen, option, quantity
from vehicle.frames import Pose2

_START: Final = Pose2(0.0, 0.0, 0.0)
_RAMP: Final = 0.3  # length of a curvature ramp: the wheels have 4 s at 8 cm/s to turn [m]
_SHORTEST: Final = 0.5  # path of a file [m]
_LONGEST: Final = 200.0  # as of the straight [m]
_TIGHTEST: Final = 1.0 - 1e-2  # radius, as of the arc, less what a fit may be tighter [m]


class RoverCourseOptions(Frozen):
    """Base class of all courses; choose your own with ``course.kind = package.module:Name``."""

    kind: str = option("Kind of the path (see offtrack parts rover_course) or package.module:Name.")

    def path(self) -> Path:
        """Build the path of R's origin; it starts at W's origin along x."""
        raise ValueError(f"course.kind = {self.kind}: the class has no method path()")


class RoverStraightOptions(RoverCourseOptions):
    """Straight ahead."""

    kind: Literal["straight"] = option("Kind of the path.")
    length: float = quantity(7.0, "m", 0.5, 200.0, "Length of the path; Reina 2008, section III: about 7 m.")

    def path(self) -> Path:
        """Build the path of R's origin; it starts at W's origin along x."""
        return Path(_START, (line(self.length),))


class RoverFigureOfEightOptions(RoverCourseOptions):
    """A full left circle, then a full right circle, with a straight before and after."""

    kind: Literal["figure-of-eight"] = option("Kind of the path.")
    radius: float = quantity(2.0, "m", 1.0, 50.0, "Radius of both circles.")
    straight: float = quantity(1.0, "m", 0.2, 50.0, "Straight before and after the circles.")

    def path(self) -> Path:
        """Build the path of R's origin; it starts at W's origin along x."""
        eight = (*_turn(self.radius, math.tau), *_turn(self.radius, -math.tau))
        return Path(_START, (line(self.straight), *eight, line(self.straight)))


class RoverArcOptions(RoverCourseOptions):
    """A straight, then an arc to the left (turn > 0) or to the right."""

    kind: Literal["arc"] = option("Kind of the path.")
    radius: float = quantity(3.0, "m", 1.0, 100.0, "Radius of the arc.")
    turn_deg: float = quantity(90.0, "deg", -720.0, 720.0, "Angle of the arc, + left.")
    straight: float = quantity(1.0, "m", 0.2, 50.0, "Straight before the arc.")

    def path(self) -> Path:
        """Build the path of R's origin; it starts at W's origin along x."""
        return Path(_START, (line(self.straight), *_turn(self.radius, math.radians(self.turn_deg))))


class RoverPathOptions(RoverCourseOptions):
    """Along the points of a file: CSV with x, y or lat, lon, GPX or GeoJSON; heights are those of ``surface``."""

    kind: Literal["path"] = option("Kind of the path.")
    file: FullPath = option("File of the path.")
    track: Word = option(TRACK, None)
    smoothing: float = quantity(0.5, "m", 0.05, 20.0, "Length of bends that are smoothed out as noise of the points.")
    tolerance: float = quantity(0.02, "m", 0.001, 1.0, "Largest distance of a point from the smooth path.")

    def path(self) -> Path:
        """Build the path of R's origin; it starts at W's origin along x."""
        source = f"course.file = {self.file}"
        fit = Fit(source=source, smoothing=self.smoothing, tolerance=self.tolerance, shortest=_SHORTEST)
        points = read_path(FilePath(self.file), self.track, heights=False, smoothing=self.smoothing)
        smooth, points = fitted_path(points, fit)
        fitted = smooth.path
        if fitted.length > _LONGEST:
            raise ValueError(f"{source}: the path is {fitted.length:.4g} m long: must be at most {_LONGEST:g} m")
        bends = [abs(segment.start_curvature) for segment in fitted.segments]
        tightest = bends.index(max(bends))
        if bends[tightest] > 1.0 / _TIGHTEST:
            place = near(points, smooth, fitted.stations[tightest])
            raise ValueError(
                f"{source}: at {fitted.stations[tightest]:.2f} m, {place}, the path has a radius of "
                f"{1.0 / bends[tightest]:.2f} m: must be at least {_TIGHTEST:g} m"
            )
        return Path(_START, fitted.segments)


def _turn(radius: float, turn: float) -> tuple[Segment, ...]:
    """A turn by ``turn`` [rad] in all: ramp, arc, ramp."""
    curvature = math.copysign(1.0 / radius, turn)
    ramp = min(_RAMP, 0.5 * radius * abs(turn))
    arc_length = radius * abs(turn) - ramp
    middle = (arc(arc_length, curvature),) if arc_length > 1e-9 else ()
    return (Segment(ramp, 0.0, curvature), *middle, Segment(ramp, curvature, 0.0))


ROVER_COURSES: Final = (RoverStraightOptions, RoverFigureOfEightOptions, RoverArcOptions, RoverPathOptions)
if TYPE_CHECKING:
    RoverCourseTable = RoverCourseOptions
else:
    RoverCourseTable = Annotated[Union[ROVER_COURSES], Field(discriminator="kind")]  # noqa: UP007  # of a tuple
