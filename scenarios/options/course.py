"""Courses of trailers: each kind is a table that builds its course. Add new kinds to ``COURSES``."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, Union

from pydantic import BeforeValidator, Field

from scenarios import courses
from scenarios.options.base import FullPath, Word, one_word
from scenarios.roads.fitted_path import Fit, stretch
from scenarios.roads.opendrive.file import read_opendrive
from scenarios.roads.opendrive.links import Edges
from scenarios.roads.opendrive.route import lane_points
from scenarios.roads.opendrive.route_search import Request
from scenarios.roads.path_file import TRACK, PathPoints, read_path
from scenarios.roads.road_course import Guided, road_course
from vehicle.combination.unit import Unit
from vehicle.foundation.quantity import Frozen, option, quantity

_TYRE_WIDTH: Final = 0.385  # single tyre of a steered axle: 385/65 R 22.5, the widest in common use [m]
_SHORTEST: Final = 10.0  # path of a combination [m]
_SHARPEST: Final = 1.0  # smoothing that sharp bends of a map are given [m]


class CourseOptions(Frozen):
    """Base class of all courses; choose your own with ``course.kind = package.module:Name``."""

    kind: str = option("Kind of the course (see offtrack parts course) or package.module:Name.")

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s].

        Raises:
            ValueError: one line, if the tractor cannot drive it.
        """
        raise ValueError(f"course.kind = {self.kind}: the class has no method course(tractor, speed)")


class RoundaboutOptions(CourseOptions):
    """The tractor's outer front corner on a circle, tangent entry and exit."""

    kind: Literal["roundabout"] = option("Kind of the course.")
    direction: Literal["left", "right"] = option("Direction of travel round the circle.", "left")
    radius: float = quantity(12.5, "m", 11.0, 100.0, "Radius of the circle of the tractor's outer front corner.")
    turn_deg: float = quantity(360.0, "deg", 30.0, 1800.0, "Angle driven round the circle.")
    entry: float = quantity(30.0, "m", 20.0, 500.0, "Straight before the circle.")
    exit: float = quantity(35.0, "m", 5.0, 500.0, "Straight after the circle.")

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s]."""
        return courses.roundabout(
            front_x=tractor.front_x,
            width=tractor.width,
            direction=self.direction,
            radius=self.radius,
            turn=math.radians(self.turn_deg),
            entry=self.entry,
            exit=self.exit,
        )


class FigureOfEightOptions(CourseOptions):
    """A full left circle, then a full right circle."""

    kind: Literal["figure-of-eight"] = option("Kind of the course.")
    radius: float = quantity(12.5, "m", 11.0, 100.0, "Radius of both circles of the tractor's outer front corner.")
    entry: float = quantity(30.0, "m", 20.0, 500.0, "Straight before the circles.")
    exit: float = quantity(35.0, "m", 5.0, 500.0, "Straight after the circles.")

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s]."""
        return courses.figure_of_eight(
            front_x=tractor.front_x, width=tractor.width, radius=self.radius, entry=self.entry, exit=self.exit
        )


class ConstantSlipOptions(CourseOptions):
    """The trailer is dragged along a straight line at a constant slip angle (de Saxe & Cebon 2018, section 3.1)."""

    kind: Literal["constant-slip"] = option("Kind of the course.")
    slip_angle_deg: float = quantity(14.0, "deg", -60.0, 60.0, "Direction of travel from the trailer's x axis, + left.")
    length: float = quantity(100.0, "m", 20.0, 1000.0, "Length of the straight line.")

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s]."""
        return courses.straight(front_x=tractor.front_x, length=self.length)


class CornerOptions(CourseOptions):
    """Base class of the low-speed turns: a point of the foremost steered axle on an arc, tangent both ends."""

    direction: Literal["left", "right"] = option("Direction of the turn.", "left")
    radius: float = quantity(12.5, "m", 8.0, 100.0, "Radius of the arc of the outer steered tyre's wall.")
    turn_deg: float = quantity(90.0, "deg", 10.0, 180.0, "Angle of the turn.")
    entry: float = quantity(30.0, "m", 20.0, 500.0, "Straight before the turn.")
    exit: float = quantity(35.0, "m", 5.0, 500.0, "Straight after the turn.")

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s]."""
        return courses.corner(
            wheel_x=tractor.steered_axles[0].x,
            wheel_y=self.guided_y(tractor),
            direction=self.direction,
            radius=self.radius,
            turn=math.radians(self.turn_deg),
            entry=self.entry,
            exit=self.exit,
        )

    def guided_y(self, tractor: Unit) -> float:
        """Distance of the guided point from the axle's centre, to the outside of the turn [m]."""
        raise NotImplementedError


class TurnOptions(CornerOptions):
    """The low-speed turn of performance-based standards: the outer steered tyre's wall on an arc, tangent both ends."""

    kind: Literal["turn"] = option("Kind of the course.")

    def guided_y(self, tractor: Unit) -> float:
        """Distance of the outer wall."""
        return outer_wall(tractor)


class AxleTurnOptions(CornerOptions):
    """The turn of AASHTO's design vehicles and the CTSW study: the front axle's centre on an arc, tangent both ends."""

    kind: Literal["axle-turn"] = option("Kind of the course.")
    radius: float = quantity(12.497, "m", 8.0, 100.0, "Radius of the front axle's centre; 12.497 m is 41 ft.")
    turn_deg: float = quantity(90.0, "deg", 10.0, 360.0, "Angle of the turn; AASHTO's templates have up to 180.")

    def guided_y(self, tractor: Unit) -> float:
        """Nothing: the centre itself."""
        return 0.0


class LaneChangeOptions(CourseOptions):
    """The single lane change of ISO 14791, at the scenario's set speed."""

    kind: Literal["lane-change"] = option("Kind of the course.")
    direction: Literal["left", "right"] = option("Side to which the lane is changed.", "left")
    frequency_hz: float = quantity(0.4, "Hz", 0.1, 2.0, "Frequency of the single period of lateral acceleration.")
    peak_acceleration: float = quantity(1.4715, "m/s2", 0.1, 6.0, "Peak lateral acceleration; 1.4715 is 0.15 g.")
    entry: float = quantity(60.0, "m", 20.0, 500.0, "Straight before the lane change.")
    exit: float = quantity(150.0, "m", 20.0, 1000.0, "Straight after the lane change.")

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s]."""
        return courses.lane_change(
            axle_x=tractor.steered_axles[0].x,
            speed=speed,
            direction=self.direction,
            frequency=self.frequency_hz,
            peak_acceleration=self.peak_acceleration,
            entry=self.entry,
            exit=self.exit,
        )


class StraightOptions(CourseOptions):
    """Straight ahead."""

    kind: Literal["straight"] = option("Kind of the course.")
    length: float = quantity(200.0, "m", 20.0, 30_000.0, "Length of the course.")

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s]."""
        return courses.straight(front_x=tractor.steered_axles[0].x, length=self.length)


class TurnTable(Frozen):
    """A turn and the straight after it."""

    direction: Literal["left", "right"] = option("Direction of the turn.")
    radius: float = quantity(12.5, "m", 8.0, 5000.0, "Radius of the path of the middle of the tractor's front.")
    turn_deg: float = quantity(90.0, "deg", 10.0, 720.0, "Angle of the turn.")
    straight: float = quantity(10.0, "m", 0.1, 5000.0, "Straight after the turn.")


class SegmentsOptions(CourseOptions):
    """A sequence of turns and straights; the middle of the tractor's front is guided."""

    kind: Literal["segments"] = option("Kind of the course.")
    entry: float = quantity(30.0, "m", 20.0, 500.0, "Straight before the first turn.")
    turns: tuple[TurnTable, ...] = Field(
        min_length=1, description="Turns, each with direction, radius, turn_deg and straight."
    )

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s]."""
        table = [courses.Turn(t.direction, t.radius, math.radians(t.turn_deg), t.straight) for t in self.turns]
        return courses.turns(front_x=tractor.front_x, width=tractor.width, sequence=table, entry=self.entry)


class _FileOptions(CourseOptions):
    """Keys of the courses from files."""

    file: FullPath = option("File of the course.")
    guided: Guided = option(
        "Point that follows the path: the middle of the first steered axle, the middle of the front, or the front "
        "corner on the outer side of the path's tighter bends.",
        "steered_axle",
    )
    smoothing: float = quantity(
        8.0,
        "m",
        1.0,
        200.0,
        "Length of bends that are smoothed out as noise; shorter where lanes of a map need it.",
    )
    tolerance: float = quantity(0.1, "m", 0.001, 10.0, "Largest distance of a point from the smooth path.")
    width: float = quantity(9.0, "m", 2.5, 100.0, "Width of the road where the file does not say.")
    heights: bool = option("Drive over the heights and banks of the file; false: on level ground.", True)

    begin: float = quantity(0.0, "m", 0.0, 1e5, "Distance along the path of the file at which the drive begins.")
    length: float | None = quantity(None, "m", 10.0, 5e4, "Length of the drive; not given: to the end of the path.")

    @property
    def source(self) -> str:
        """The file, for messages."""
        return f"course.file = {self.file}"

    def course(self, tractor: Unit, speed: float) -> courses.Course:
        """Build the course for a tractor at a set speed [m/s]."""
        return self.course_along(self.points(tractor), tractor)

    def course_along(self, points: PathPoints, tractor: Unit) -> courses.Course:
        """Build the course along points of the file for a tractor."""
        if not self.heights:
            points = replace(points, heights=None, banks=None)
        least = _SHARPEST if self.kind == "opendrive" else math.inf  # points of tracks are noisy, those of maps are not
        fit = Fit(self.source, self.smoothing, self.tolerance, _SHORTEST, least)
        return road_course(points, fit, tractor, self.guided, self.width)

    def points(self, tractor: Unit) -> PathPoints:
        """Read the points of the file that are driven."""
        raise NotImplementedError


class PathOptions(_FileOptions):
    """Along the points of a file: CSV with x, y or lat, lon (and z, bank, left_width, …), GPX, GeoJSON or OpenCRG."""

    kind: Literal["path"] = option("Kind of the course.")
    track: Word = option(TRACK, None)

    def points(self, tractor: Unit) -> PathPoints:
        """Read the points of the file that are driven."""
        points = read_path(Path(self.file), self.track, heights=self.heights, smoothing=self.smoothing)
        return stretch(points, self.begin, self.length, self.source)


def _words(value: object) -> object:
    """Words as a tuple of texts: a list, one word, or words with commas between them."""
    if isinstance(value, str):
        return tuple(word.strip() for word in value.split(",") if word.strip())
    return tuple(map(one_word, value)) if isinstance(value, tuple | list) else (one_word(value),)


class OpenDriveOptions(_FileOptions):
    """Along the lanes of roads in an OpenDRIVE file."""

    kind: Literal["opendrive"] = option("Kind of the course.")
    road: Word = option(
        "Id of the road to start on; not given: the first of the route, or that of the longest drive.", None
    )
    lane: int | None = option(
        "Id of the lane to start on, where it begins; not given: that of the longest drive, or the outermost.", None
    )
    route: Annotated[tuple[str, ...], BeforeValidator(_words)] = option(
        "Ids of roads in the order of driving; left, right or straight at junctions; changes of lane: lane ID, "
        "lane ID from S, lane ID from S over LENGTH [m]. The drive ends where the route does not say how to go on.",
        (),
    )
    edges: Edges = option("Edges of the road: those of the lane, or of all paved lanes beside it (road).", "lane")

    def points(self, tractor: Unit) -> PathPoints:
        """Read the points of the file that are driven."""
        request = Request(
            road=self.road,
            lane=self.lane,
            words=self.route,
            heights=self.heights,
            edges=self.edges,
            begin=self.begin,
            length=self.length,
            narrowest=tractor.width if self.edges == "lane" else 0.5 * tractor.width,
        )
        network = read_opendrive(Path(self.file))
        return replace(lane_points(network, request, self.source), placement=network.placement)


def outer_wall(tractor: Unit) -> float:
    """Lateral distance from the centre line to the outer walls of the tractor's first steered tyres [m]."""
    return 0.5 * (tractor.steered_axles[0].track + _TYRE_WIDTH)


COURSES: Final = (
    RoundaboutOptions,
    FigureOfEightOptions,
    ConstantSlipOptions,
    TurnOptions,
    AxleTurnOptions,
    LaneChangeOptions,
    StraightOptions,
    SegmentsOptions,
    PathOptions,
    OpenDriveOptions,
)
if TYPE_CHECKING:
    CourseTable = CourseOptions
else:
    CourseTable = Annotated[Union[COURSES], Field(discriminator="kind")]  # noqa: UP007  # of a tuple of classes
