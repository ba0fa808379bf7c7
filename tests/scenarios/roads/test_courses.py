"""The geometry of the courses."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.assembly.adapters import course_of
from scenarios.courses import Course, Turn, corner, figure_of_eight, lane_change, roundabout, straight, turns
from scenarios.options.scenario import Scenario, load_any_scenario, load_scenario
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

TRACTOR: dict[str, Any] = {"front_x": 5.2, "width": 2.55}
ALL = {
    "left": roundabout(**TRACTOR),
    "right": roundabout(**TRACTOR, direction="right"),
    "quarter": roundabout(**TRACTOR, turn=math.pi / 2, radius=15.0),
    "eight": figure_of_eight(**TRACTOR),
    "straight": straight(front_x=5.2, length=50.0),
    "corner": corner(wheel_x=3.8, wheel_y=1.2),
    "turns": turns(**TRACTOR, sequence=[Turn("left", 11.0, math.pi / 2, 12.0), Turn("right", 11.0, math.pi / 2, 30.0)]),
    "lane change": lane_change(axle_x=3.8, speed=88.0 / 3.6),
}
courses = pytest.mark.parametrize("course", ALL.values(), ids=ALL.keys())


@courses
def test_the_tractor_starts_at_the_origin_with_its_guided_point_on_the_path(course: Course) -> None:
    """X_WT is the origin heading +x, so the guided point's position in T is the path's start."""
    assert course.start == (0.0, 0.0, 0.0)
    start = course.path.pose(0.0)
    assert (start.x, start.y, start.psi) == (*course.reference, 0.0)


@courses
def test_position_and_heading_of_the_path_are_continuous(course: Course) -> None:
    """Tangent joints: across 1 mm no point moves by more than 1 mm, no heading by more than its largest curvature."""
    for station in course.path.stations:
        before, after = course.path.pose(station - 5e-4), course.path.pose(station + 5e-4)
        assert math.hypot(after.x - before.x, after.y - before.y) <= 1e-3 + 1e-9
        assert abs(after.psi - before.psi) <= 1e-3 / 10.0  # no course is tighter than 10 m


@pytest.mark.parametrize(("name", "side"), [("left", 1.0), ("right", -1.0)])
def test_the_outer_front_corner_goes_round_the_circle_once(name: str, side: float) -> None:
    """The corner on the far side from the centre is on the 12.5 m circle from tangent entry to tangent exit."""
    course = ALL[name]
    assert course.reference == (5.2, -side * 1.275)
    assert course.surface_centre == (5.2 + 30.0, side * (12.5 - 1.275))
    centre = np.array(course.surface_centre)
    on_circle = np.array([course.path.pose(30.0 + s)[:2] for s in np.linspace(0.0, math.tau * 12.5, 50)])
    assert np.hypot(*(on_circle - centre).T) == pytest.approx(12.5, abs=1e-9)
    assert course.path.pose(course.length).psi == pytest.approx(side * math.tau, abs=1e-9)
    assert course.length == pytest.approx(30.0 + math.tau * 12.5 + 35.0)


@courses
def test_the_buffer_fills_before_the_turn_and_the_trailer_leaves_it_after(course: Course) -> None:
    """More than 20 m straight before, 30 m after: the hitch goes as far as the guided point while it is straight."""
    first, last = course.path.segments[0], course.path.segments[-1]
    assert first.turn == last.turn == 0.0
    assert first.length > 20.0
    assert last.length >= 30.0


def test_figure_of_eight_is_a_full_left_and_a_full_right_circle() -> None:
    """The heading rises by 2 pi and falls back; past its middle the figure is the point image of the first half."""
    path = ALL["eight"].path
    headings = [path.pose(s).psi for s in np.linspace(0.0, path.length, 2000)]
    assert max(headings) == pytest.approx(math.tau, abs=1e-3)  # sampled every 11 cm around the maximum
    assert headings[-1] == pytest.approx(0.0, abs=1e-9)
    middle = 30.0 + 0.5 * (path.length - 30.0 - 35.0)
    at = path.pose(middle)
    assert path.curvature(middle) == pytest.approx(0.0, abs=1e-12)
    for s in np.linspace(0.0, middle - 30.0, 20):
        back, on = path.pose(middle - s), path.pose(middle + s)
        assert (back.x + on.x, back.y + on.y) == pytest.approx((2 * at.x, 2 * at.y), abs=1e-9)


def test_figure_of_eight_puts_the_outer_front_corner_on_the_circle() -> None:
    """In the steady part: rear axle on R_r, front middle on hypot(R_r, x_f), outer corner on hypot(R_r + w/2, x_f)."""
    arc = max(ALL["eight"].path.segments, key=lambda segment: segment.length)
    guided_radius = 1.0 / arc.start_curvature
    rear_radius = math.sqrt(guided_radius**2 - 5.2**2)
    assert math.hypot(rear_radius + 1.275, 5.2) == pytest.approx(12.5, abs=1e-12)


def test_curvature_of_the_figure_of_eight_never_jumps() -> None:
    """From lock to lock no driver can jump: 2 m of path change the curvature by at most half of the circle's."""
    path = ALL["eight"].path
    curvature = np.array([path.curvature(s) for s in np.arange(0.0, path.length, 0.1)])
    assert np.abs(curvature[20:] - curvature[:-20]).max() <= 0.5 * curvature.max() + 1e-9


@courses
def test_the_road_lies_where_the_rear_axle_rolls(course: Course) -> None:
    """The centreline starts behind the start, passes the origin, and its points are evenly spread along the way.

    A rear axle rolls along its own heading: the guided point is x_ref ahead on the tangent and y_ref beside it.
    """
    line = course.centreline
    assert line[0] == pytest.approx([-40.0, 0.0], abs=1e-9)
    assert np.hypot(*line.T).min() < 1e-9
    steps = np.diff(line, axis=0)
    assert np.hypot(*steps.T).max() <= 0.5 + 0.1  # a rear axle on the outside of a pivoting front moves little faster
    tangents = line[2:] - line[:-2]
    tangents /= np.hypot(*tangents.T)[:, None]
    normals = tangents @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    guided = line[1:-1] + tangents * course.reference[0] + normals * course.reference[1]
    stations = -40.0 + 0.5 * np.arange(1, len(line) - 1)
    expected = np.array([course.path.pose(float(s))[:2] for s in stations])
    assert np.hypot(*(guided - expected).T).max() < 0.05  # central differences over 1 m, at most where curvature jumps


def test_the_corner_leads_the_outer_wheel_round_a_quarter_of_its_arc() -> None:
    """The wheel 3.8 m ahead and 1.2 m to the right, on 12.5 m about a centre as far to the left of the straight."""
    course = ALL["corner"]
    assert course.reference == (3.8, -1.2)
    end = course.path.knots[-1]
    assert end.psi == pytest.approx(math.pi / 2)
    assert course.path.length == pytest.approx(30.0 + 12.5 * math.pi / 2 + 35.0)
    assert (end.x, end.y) == pytest.approx((3.8 + 30.0 + 12.5, -1.2 + 12.5 + 35.0))
    mirrored = corner(wheel_x=3.8, wheel_y=1.2, direction="right")
    assert mirrored.centreline == pytest.approx(course.centreline * [1.0, -1.0], abs=1e-9)


def test_turns_follow_one_another_as_asked() -> None:
    path = ALL["turns"].path
    round_ = 11.0 * math.pi / 2 + 4.0  # two ramps of 4 m turn as far as one such arc
    first, second = 30.0 + 0.5 * round_, 30.0 + 1.5 * round_ + 12.0
    assert [path.curvature(s) for s in (first, second)] == pytest.approx([1 / 11.0, -1 / 11.0])
    assert path.pose(30.0 + round_ + 6.0).psi == pytest.approx(math.pi / 2)
    assert path.knots[-1].psi == pytest.approx(0.0, abs=1e-12)
    assert path.length == pytest.approx(30.0 + 2 * round_ + 12.0 + 30.0)
    curvature = np.array([path.curvature(s) for s in np.arange(0.0, path.length, 0.1)])
    assert np.abs(np.diff(curvature)).max() <= 0.1 / 4.0 / 11.0 + 1e-12


@pytest.mark.parametrize("direction", ["left", "right"])
def test_the_lane_change_has_the_offset_and_the_acceleration_of_the_standard(direction: Any) -> None:
    """1.4637 m; 0.15 g at 88 km/h, the 32 pieces of the wave hit its peaks. The path's slope shortens it by 0.1 %."""
    speed = 88.0 / 3.6
    path = lane_change(axle_x=3.8, speed=speed, direction=direction).path
    side = 1.0 if direction == "left" else -1.0
    assert side * path.knots[-1].y == pytest.approx(1.4637, rel=5e-3)  # 0.3 % for the wave's straight pieces
    assert path.knots[-1].psi == pytest.approx(0.0, abs=1e-12)
    curvature = [side * path.curvature(float(s)) for s in np.linspace(0.0, path.length, 5000)]
    assert max(curvature) * speed**2 == pytest.approx(1.4715, rel=1e-3)
    assert min(curvature) * speed**2 == pytest.approx(-1.4715, rel=1e-3)
    assert curvature.index(max(curvature)) < curvature.index(min(curvature))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: roundabout(**TRACTOR, radius=5.0), "radius = 5.0 m"),
        (lambda: roundabout(**TRACTOR, entry=0.0), "length = 0.0"),
        (lambda: figure_of_eight(**TRACTOR, exit=-1.0), "length = -1.0"),
        (lambda: straight(front_x=5.2, length=0.0), "length = 0.0"),
        (lambda: corner(wheel_x=3.8, wheel_y=1.2, radius=3.0), "radius = 3.0 m"),
        (lambda: corner(wheel_x=3.8, wheel_y=1.2, turn=0.0), "length = 0.0"),
        (lambda: turns(**TRACTOR, sequence=[]), "turns is empty"),
        (lambda: turns(**TRACTOR, sequence=[Turn("left", 11.0, 0.3, 9.0)]), "turn of 3.30 m"),
        (lambda: turns(**TRACTOR, sequence=[Turn("left", 4.0, 3.0, 9.0)]), "radius = 4.0 m"),
        (
            lambda: turns(**TRACTOR, sequence=[Turn("left", 5000.0, 4.0 * math.pi, 10.0)]),
            r"the course is 62\.9 km long: must be at most 20 km",
        ),
        (lambda: lane_change(axle_x=3.8, speed=2.0), "lane change of 1.46 m over 5.00 m"),
    ],
)
def test_an_impossible_course_is_refused(build: Callable[[], Course], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()


def test_a_course_of_ones_own_is_named_by_its_import_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its table is checked like those that come with offtrack, and the resolved scenario names it again."""
    (tmp_path / "depots.py").write_text(
        "from scenarios.courses import straight\n"
        "from scenarios.options.base import quantity\n"
        "from scenarios.options.course import CourseOptions\n"
        "class Depot(CourseOptions):\n"
        "    length: float = quantity(40.0, 'm', 20.0, 50.0, 'Length.')\n"
        "    def course(self, tractor, speed):\n"
        "        return straight(front_x=tractor.front_x, length=self.length)\n"
        "class NoCourse:\n"
        "    pass\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    scenario = load_scenario("roundabout", ["course.kind=depots:Depot", "course.length=45"])
    assert course_of(scenario, load_vehicle(scenario.vehicle)).length == pytest.approx(45.0)
    assert 'kind = "depots:Depot"' in scenario.to_toml()
    with pytest.raises(ValueError, match=r"course\.length = 99 m must be between 20 and 50 m"):
        load_scenario("roundabout", ["course.kind=depots:Depot", "course.length=99"])
    with pytest.raises(ValueError, match=r"course\.kind = depots:NoCourse: the class must be derived from"):
        load_scenario("roundabout", ["course.kind=depots:NoCourse"])
    with pytest.raises(ValueError, match=r"course\.kind = depots:None_: module depots has no 'None_'"):
        load_scenario("roundabout", ["course.kind=depots:None_"])


# The shipped roads have the sizes that their files and the documentation state


def shipped(name: str) -> Course:
    scenario = load_any_scenario(name)
    assert isinstance(scenario, Scenario)
    return scenario.course.course(load_vehicle(scenario.vehicle).units[0], scenario.speed)


def curvature(course: Course) -> FloatArray:
    return np.array([course.path.curvature(s) for s in np.arange(0.0, course.length, 0.25)])


def turned(course: Course) -> float:
    """Heading at the end, from that at the start [deg]."""
    return math.degrees(course.path.pose(course.length).psi - course.path.start.psi)


def test_the_depot_is_left_the_way_it_was_entered_round_a_loop_of_11_m() -> None:
    course = shipped("depot")
    assert turned(course) == pytest.approx(180.0, abs=0.1)
    assert np.median(curvature(course)[curvature(course) > 0.05]) == pytest.approx(1.0 / 11.0, rel=0.01)
    assert course.friction is not None
    assert course.relief is not None
    along = course.centreline
    assert course.friction.at(along[:, 0], along[:, 1]).min() == pytest.approx(0.4)


def test_the_mini_roundabout_keeps_the_corner_06_m_inside_a_circle_of_28_m() -> None:
    course = shipped("mini-roundabout")
    assert turned(course) == pytest.approx(-90.0, abs=0.1)
    bends = curvature(course)
    assert np.median(bends[bends < -0.05]) == pytest.approx(-1.0 / 13.4, rel=0.01)
    assert np.median(bends[bends > 0.03]) == pytest.approx(1.0 / 26.2, rel=0.02)
    assert isinstance(course.road_half_width, np.ndarray)
    left, right = course.road_half_width[200:-200].T
    assert left.min() == pytest.approx(0.6, abs=0.03)  # averaged over two metres
    assert right.max() == pytest.approx(13.0, abs=0.05)


def test_the_turbo_roundabout_spirals_from_the_inside_to_the_outside_lane() -> None:
    course = shipped("turbo-roundabout")
    assert turned(course) == pytest.approx(90.0, abs=0.1)
    radii = 1.0 / curvature(course)[curvature(course) > 0.04]
    assert np.percentile(radii, 25) == pytest.approx(0.5 * (12.0 + 17.15), rel=0.01)
    assert np.percentile(radii, 90) == pytest.approx(0.5 * (17.45 + 22.45), rel=0.02)


def test_the_motorway_exit_is_banked_into_its_bend_and_climbs() -> None:
    course = shipped("motorway-exit")
    middle = 0.5 * 4.5  # the driven lane lies inside the bend's reference line
    assert curvature(course).min() == pytest.approx(-1.0 / (60.0 - middle), rel=0.01)
    assert turned(course) == pytest.approx(-math.degrees(110.0 / 60.0 + 1.0), abs=0.1)
    assert course.relief is not None
    line = course.centreline
    tightest = int(np.argmin([course.path.curvature(s) for s in np.arange(0.0, course.length, 0.25)]))
    place, ahead = line[tightest + 160], line[tightest + 164]
    along = (ahead - place) / math.dist(ahead, place)
    left = np.array([-along[1], along[0]])
    points = np.array([place, place + left, place + along])
    heights = course.relief.height(points[:, 0], points[:, 1])
    assert heights[1] - heights[0] == pytest.approx(0.06, abs=0.003)  # the inside, on the right, is lower
    assert heights[2] - heights[0] == pytest.approx(0.04, abs=0.003)
