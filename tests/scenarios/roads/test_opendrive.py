"""OpenDRIVE: reference lines, lanes and routes against closed forms, and one line for every file that is wrong."""

import math
import time
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import fresnel

from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.courses import Course
from scenarios.options.scenario import load_scenario
from scenarios.roads.opendrive.file import read_opendrive
from scenarios.roads.opendrive.network import Road
from scenarios.roads.opendrive.route import LINES, lane_points
from scenarios.roads.opendrive.route_search import Request
from scenarios.roads.path_file import PathPoints
from tests.open_drive import TWO_LANES, Piece, Start, bend, crossing, file, lane, lanes, road
from vehicle.frames import FloatArray

ANY: Final = Request()
START: Final = 'x="3" y="-2" hdg="0.5"'


def one_road(folder: Path, text: str) -> Road:
    """The road with the id 1 of a file of this text."""
    (folder / "road.xodr").write_text(text, encoding="utf-8")
    return read_opendrive(folder / "road.xodr").roads["1"]


def of_shape(folder: Path, shape: str, length: float) -> Road:
    plan = f'<planView><geometry s="0" {START} length="{length}">{shape}</geometry></planView>'
    return one_road(folder, file(f'<road id="1" length="{length}" junction="-1">{plan}{TWO_LANES}</road>'))


def route(folder: Path, text: str, request: Request = ANY) -> PathPoints:
    (folder / "road.xodr").write_text(text, encoding="utf-8")
    return lane_points(read_opendrive(folder / "road.xodr"), request, "road.xodr")


def course(folder: Path, text: str, *settings: str) -> Course:
    (folder / "road.xodr").write_text(text, encoding="utf-8")
    file_ = f"course.file={folder / 'road.xodr'}"
    scenario = load_scenario("roundabout", ["course.kind=opendrive", file_, "off_tracking=truth", *settings])
    return course_of(scenario, vehicle_of(scenario))


def in_file(u: FloatArray, v: FloatArray) -> FloatArray:
    """Positions in the file of a point in the frame of the geometry."""
    z = (3.0 - 2.0j) + (u + 1j * v) * np.exp(0.5j)
    return np.stack([z.real, z.imag], axis=1)


def test_an_arc_is_a_circle(tmp_path: Path) -> None:
    s = np.linspace(0.0, 30.0, 7)
    poses = of_shape(tmp_path, '<arc curvature="-0.04"/>', 30.0).reference.poses(s)
    assert poses[:, :2] == pytest.approx(in_file(25.0 * np.sin(s / 25.0), -25.0 * (1.0 - np.cos(s / 25.0))), abs=1e-12)
    assert poses[:, 2] == pytest.approx(0.5 - s / 25.0)


def test_a_spiral_is_an_integral_of_fresnel(tmp_path: Path) -> None:
    """Curvature from 0 to 0.02 over 50 m: x + iy is sqrt(pi/c) (C + iS) at s sqrt(c/pi), c = 0.02/50."""
    s, c = np.linspace(0.0, 50.0, 6), 0.02 / 50.0
    size = math.sqrt(math.pi / c)
    sines, cosines = fresnel(s / size)
    poses = of_shape(tmp_path, '<spiral curvStart="0" curvEnd="0.02"/>', 50.0).reference.poses(s)
    assert poses[:, :2] == pytest.approx(in_file(size * cosines, size * sines), abs=1e-10)
    assert poses[:, 2] == pytest.approx(0.5 + 0.5 * c * s**2)


@pytest.mark.parametrize(("kind", "end"), [("normalized", 1.0), ("arcLength", 20.0)])
def test_a_parametric_cubic_is_its_polynomials(tmp_path: Path, kind: str, end: float) -> None:
    """The parameter runs to 1, or to the length; the same curve, its coefficients scaled by powers of the end."""
    b, c, d = 19.9 / end, 1.5 / end**2, -0.6 / end**3
    shape = f'<paramPoly3 pRange="{kind}" aU="0" bU="{b!r}" cU="0" dU="0" aV="0" bV="0" cV="{c!r}" dV="{d!r}"/>'
    poses = of_shape(tmp_path, shape, 20.0).reference.poses(np.array([0.0, 10.0, 20.0]))
    p = np.array([0.0, 0.5, 1.0])
    assert poses[:, :2] == pytest.approx(in_file(19.9 * p, 1.5 * p**2 - 0.6 * p**3), abs=1e-12)
    assert poses[:, 2] == pytest.approx(0.5 + np.arctan2(3.0 * p - 1.8 * p**2, 19.9))


def test_a_cubic_is_measured_along_itself(tmp_path: Path) -> None:
    """v(u) = u^2/40 - u^3/6000: its length up to the returned u is s, integrated by another rule."""
    s = np.array([0.0, 7.0, 15.0, 30.0])
    poses = of_shape(tmp_path, '<poly3 a="0" b="0" c="0.025" d="-0.0001666666666666667"/>', 30.0).reference.poses(s)
    local = ((poses[:, 0] + 1j * poses[:, 1]) - (3.0 - 2.0j)) * np.exp(-0.5j)
    assert local.imag == pytest.approx(local.real**2 / 40.0 - local.real**3 / 6000.0, abs=1e-12)
    lengths = [quad(lambda u: math.hypot(1.0, u / 20.0 - u**2 / 2000.0), 0.0, u)[0] for u in local.real.tolist()]
    assert lengths == pytest.approx(s.tolist(), abs=1e-9)


def test_lanes_lie_beside_each_other_and_roll_with_the_road(tmp_path: Path) -> None:
    """Offset of lane 0, a second lane that grows, 0.1 rad of superelevation that falls to the right, 3 % of grade."""
    growing = '<lane id="-2" type="driving"><width sOffset="0" a="3" b="0.01" c="0" d="0"/></lane>'
    profiles = (
        '<elevationProfile><elevation s="0" a="5" b="0.03" c="0" d="0"/></elevationProfile>'
        '<lateralProfile><superelevation s="0" a="0.1" b="0" c="0" d="0"/></lateralProfile>'
    )
    inside = profiles + lanes([], [lane(-1), growing], '<laneOffset s="0" a="0.5" b="0" c="0" d="0"/>')
    points = route(tmp_path, file(road("1", (Piece(100.0),), inside)), Request(lane=-2))
    s = points.places[:, 0]
    t = 0.5 - 4.0 - 0.5 * (3.0 + 0.01 * s)
    assert points.places[:, 1] == pytest.approx(t * math.cos(0.1))
    assert points.heights == pytest.approx(5.0 + 0.03 * s + t * math.sin(0.1))
    assert points.banks == pytest.approx(np.full(len(s), math.tan(0.1)))
    assert points.widths == pytest.approx(np.tile(0.5 * (3.0 + 0.01 * s)[:, None], (1, 2)))


def test_a_crowned_road_banks_its_lanes(tmp_path: Path) -> None:
    """A crown that falls 2.5 % to both sides at the begin and is flat 50 m on; half way it falls 1.25 %."""
    crown = (
        '<shape s="0" t="-4" a="-0.1" b="0.025" c="0" d="0"/><shape s="0" t="0" a="0" b="-0.025" c="0" d="0"/>'
        '<shape s="50" t="-4" a="0" b="0" c="0" d="0"/>'
    )
    inside = f"<lateralProfile>{crown}</lateralProfile>{TWO_LANES}"
    text = file(road("1", (Piece(100.0),), inside))
    for number, side in ((-1, 1.0), (1, 1.0)):  # travel on either side has the middle of the road on its left
        points = route(tmp_path, text, Request(lane=number))
        fall = 0.025 * np.clip(1.0 - points.places[:, 0] / 50.0, 0.0, 1.0)
        assert points.heights == pytest.approx(-2.0 * fall)
        assert points.banks == pytest.approx(side * fall)


def test_crossfall_and_superelevation_add_up(tmp_path: Path) -> None:
    """Angles add: 0.02 rad that falls outwards on the right, on a road that rolls by 0.03 rad to the right."""
    profile = (
        '<superelevation s="0" a="0.03" b="0" c="0" d="0"/><crossfall side="{}" s="0" a="0.02" b="0" c="0" d="0"/>'
    )
    for side, fall in (("right", 0.02), ("both", 0.02), ("left", 0.0)):
        inside = f"<lateralProfile>{profile.format(side)}</lateralProfile>{TWO_LANES}"
        points = route(tmp_path, file(road("1", (Piece(100.0),), inside)))
        assert points.banks == pytest.approx(math.tan(0.03 + fall))
        assert points.heights == pytest.approx(-2.0 / math.cos(fall) * math.sin(0.03 + fall))


def test_a_lane_on_the_left_is_driven_against_the_reference_line(tmp_path: Path) -> None:
    """It comes from the end, its bank is mirrored, and its neighbours are on the other side."""
    roll = '<lateralProfile><superelevation s="0" a="0.05" b="0" c="0" d="0"/></lateralProfile>'
    inside = roll + lanes([lane(2, kind="shoulder", width=1.5), lane(1)], [lane(-1), lane(-2, kind="sidewalk")])
    points = route(tmp_path, file(road("1", (Piece(60.0),), inside)), Request(lane=1, edges="road"))
    assert points.places[[0, -1], 0] == pytest.approx([60.0, 0.0])
    assert points.places[:, 1] == pytest.approx(2.0 * math.cos(0.05))
    assert points.banks is not None
    assert points.banks[0] == pytest.approx(-math.tan(0.05))
    assert points.widths is not None
    assert points.widths[0] == pytest.approx(
        [2.0 + 4.0, 2.0 + 1.5]
    )  # the oncoming lane, not the sidewalk; the shoulder


def test_traffic_on_the_left_drives_the_left_lane_along_the_road(tmp_path: Path) -> None:
    text = file(road("1", (Piece(60.0),), TWO_LANES)).replace('junction="-1"', 'junction="-1" rule="LHT"')
    points = route(tmp_path, text)
    assert points.places[[0, -1]] == pytest.approx(np.array([[0.0, 2.0], [60.0, 2.0]]))


@pytest.mark.parametrize(
    ("words", "end"),
    [
        (("left",), (22.0, 70.0)),
        (("straight",), (90.0, -2.0)),
        (("right",), (18.0, -70.0)),
        (("1", "3"), (22.0, 70.0)),
        (("1", "14"), (18.0, -20.0)),
        ((), (0.0, -2.0)),
    ],
)
def test_a_route_leads_through_a_junction(tmp_path: Path, words: tuple[str, ...], end: tuple[float, float]) -> None:
    """By a turn, by the road behind it, or by the connecting road; without a word it ends before the junction."""
    points = route(tmp_path, crossing(), Request(words=words))
    assert points.places[0] == pytest.approx([-50.0, -2.0])
    assert points.places[-1] == pytest.approx(end, abs=1e-9)
    steps = np.hypot(*np.diff(points.places, axis=0).T)
    assert 0.4 < steps.min() < steps.max() < 1.6  # chords of the lanes; a point is left out where two roads meet


def test_a_lane_changes_its_number_between_sections(tmp_path: Path) -> None:
    """A lane is added on the inside after 30 m: what was -1 is then -2, at the same place."""
    link = '<successor id="-2"/>'
    first = lanes([], [lane(-1, link=link)])
    second = lanes([], [lane(-1, width=0.0), lane(-2)]).replace('laneSection s="0"', 'laneSection s="30"')
    both = first.replace("</lanes>", "") + second.replace("<lanes>", "")
    points = route(tmp_path, file(road("1", (Piece(60.0),), both)))
    assert points.places[:, 1] == pytest.approx(-2.0)
    assert points.places[-1, 0] == pytest.approx(60.0)


def test_a_ring_is_driven_once(tmp_path: Path) -> None:
    """A road whose end is its begin: without a route one lap, with its name twice two."""
    link = '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
    link += '<successor elementType="road" elementId="1" contactPoint="start"/>'
    text = file(road("1", (Piece(math.tau * 20.0, 0.05),), TWO_LANES, link=link))
    lap = len(route(tmp_path, text).places)
    assert len(route(tmp_path, text, Request(words=("1", "1"))).places) == pytest.approx(2 * lap, abs=1)
    assert lap == pytest.approx(math.tau * 20.0, abs=2)  # a metre of the reference line apart


def test_a_very_short_road_leaves_no_gap(tmp_path: Path) -> None:
    """A connecting road of 40 cm between two others has no point of its own."""
    link = '<successor elementType="road" elementId="{}" contactPoint="start"/>'
    starts = {"1": (0.0, 50.0), "2": (50.0, 0.4), "3": (50.4, 50.0)}
    roads = [
        road(name, (Piece(length),), TWO_LANES, start=Start(x), link=link.format(int(name) + 1) if name < "3" else "")
        for name, (x, length) in starts.items()
    ]
    points = route(tmp_path, file(*roads))
    assert points.places[-1] == pytest.approx([100.4, -2.0])
    assert np.diff(points.places[:, 0]).max() < 1.5


def test_a_course_feels_heights_and_banks_of_the_road(tmp_path: Path) -> None:
    """The ground 30 m on is 0.9 m higher; its slope is that of the road, also beside the lane's middle."""
    profiles = (
        '<elevationProfile><elevation s="0" a="5" b="0.03" c="0" d="0"/></elevationProfile>'
        '<lateralProfile><superelevation s="0" a="-0.04" b="0" c="0" d="0"/></lateralProfile>'
    )
    driven = course(tmp_path, file(road("1", (Piece(100.0),), profiles + TWO_LANES)))
    assert driven.relief is not None
    x = driven.reference[0] + 30.0
    assert driven.relief.height(x, 0.0) == pytest.approx(0.9, abs=1e-6)
    assert driven.relief.gradient(x, 1.0) == pytest.approx([0.03, -math.tan(0.04)], abs=1e-6)
    assert driven.road_half_width == pytest.approx(np.full((len(driven.centreline), 2), 2.0))
    assert course(tmp_path, file(road("1", (Piece(100.0),), TWO_LANES)), "course.length=40").length == pytest.approx(40)


def test_the_begin_and_length_of_the_drive_are_chosen(tmp_path: Path) -> None:
    """From 40 m on the road turns at once."""
    driven = course(tmp_path, bend(20.0, math.pi), "course.begin=40", "course.length=30")
    assert driven.length == pytest.approx(30.0, abs=1.0)  # whole points
    assert driven.path.curvature(5.0) == pytest.approx(1.0 / 20.0, rel=0.01)


def test_30_km_of_road_load_in_time(tmp_path: Path) -> None:
    """Six hundred pieces, and an elevation every 25 m: the bar is 3 s for file and course; processor time."""
    pieces = [Piece(50.0, 0.002 * math.sin(0.7 * k)) for k in range(600)]
    heights = "".join(f'<elevation s="{25 * k}" a="10" b="0" c="0" d="0"/>' for k in range(1200))
    text = file(road("1", pieces, f"<elevationProfile>{heights}</elevationProfile>{TWO_LANES}"))
    (tmp_path / "road.xodr").write_text(text, encoding="utf-8")
    begin = time.process_time()
    network = read_opendrive(tmp_path / "road.xodr")
    points = lane_points(network, Request(), "road.xodr")
    assert time.process_time() - begin < 3.0
    assert network.roads["1"].reference.length == pytest.approx(30_000.0)
    assert len(points.places) == pytest.approx(30_000, abs=2)


ROAD: Final = bend(20.0, math.pi)
KINK: Final = '<geometry s="50" x="50" y="0" hdg="1.2" length="50"><line/></geometry></planView>'
WALL: Final = '<elevation s="0" a="0" b="0.9" c="0" d="0"/>'
LEANING: Final = '<shape s="0" t="0" a="0" b="-0.9" c="0" d="0"/>'
RAISED: Final = f"<elevationProfile>{WALL}</elevationProfile>{TWO_LANES}".replace('a="0" b="0.9"', 'a="0.4" b="0"')
LINKED: Final = '<link><successor elementType="road" elementId="{}" contactPoint="start"/></link><planView>'


def changed(old: str, new: str, text: str = ROAD) -> str:
    assert old in text
    return text.replace(old, new, 1)


REFUSED: Final = {
    "empty": ("", "not XML"),
    "no road": ("<OpenDRIVE/>", "has no <road>"),
    "other XML": ("<gpx/>", "must be <OpenDRIVE>"),
    "NaN": (changed('hdg="0.0"', 'hdg="nan"'), "hdg = 'nan' is not a finite number"),
    "backwards": (changed('length="30.0">', 'length="-30">'), "must be positive"),
    "a gap": (changed('x="30.0"', 'x="35"'), "a gap of 5 m in the reference line at s = 30.0 m"),
    "a kink": (file(road("1", (Piece(50.0),), TWO_LANES).replace("</planView>", KINK)), "would have to steer"),
    "gap of s": (changed('s="30.0"', 's="40"'), "ends at s = 30.000 m, this one begins at 40.000 m"),
    "late begin": (file(road("1", (Piece(50.0),), TWO_LANES)).replace('s="0.0"', 's="7"'), "must be 0"),
    "no plan view": (ROAD.replace("planView", "plan"), "<road> has no <planView>"),
    "no shape": (changed("<line/>", ""), "has 0 shapes: must be one of line, arc"),
    "late section": (changed('laneSection s="0"', 'laneSection s="900"'), "lane sections from s = 900"),
    "curvature": (changed('curvature="', 'curvature="99'), "must be within -10 to 10 1/m"),
    "coil": (changed("<line/>", '<spiral curvStart="9" curvEnd="9"/>'), "must be within 12.566 rad"),
    "no id": (changed('<road id="1"', "<road"), "<road> has no attribute 'id'"),
    "two of a name": (changed("</road>", "</road>" + road("1", (Piece(9.0),), TWO_LANES)), "two roads have the id '1'"),
    "half a lane": (changed('id="-1"', 'id="-1.5"'), "must be a whole number"),
    "lane 100000": (changed('id="-1"', 'id="-100000"'), "must be within -100 to 100"),
    "footpath": (changed('"driving"', '"sidewalk"'), "has no lane of the type driving"),
    "narrow": (changed('a="9.0"', 'a="1.5"'), "the road is 1.50 m wide"),
    "pRange": (changed("<line/>", '<paramPoly3 pRange="x" aU="0" bU="1" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"/>'),
               "must be arcLength or normalized"),
    "wild cubic": (changed("<line/>", '<poly3 a="0" b="1e8" c="1e8" d="1e8"/>'), "a gap of"),
    "wall": (changed("<lanes>", f"<elevationProfile>{WALL}</elevationProfile><lanes>"), "slope = 0.9"),
    "too tight": (bend(4.0, math.pi, width=4.0), "would have to steer"),
    "link to elsewhere": (changed("<planView>", LINKED.format("2"), file(
        road("1", (Piece(50.0),), TWO_LANES), road("2", (Piece(50.0),), TWO_LANES, start=Start(60.0, 0.0, 0.0)))),
        "a gap of 10 m between the lanes at the begin of road 2"),
    "no end": (changed("<planView>", LINKED.format("2").replace(' contactPoint="start"', ""), file(
        road("1", (Piece(50.0),), TWO_LANES), road("2", (Piece(50.0),), TWO_LANES, start=Start(50.0, 0.0, 0.0)))),
        'line 2: the link of road 1 to road 2 does not say contactPoint="start" or "end"'),
    "step": (changed("<planView>", LINKED.format("2"), file(
        road("1", (Piece(50.0),), TWO_LANES), road("2", (Piece(50.0),), RAISED, start=Start(50.0, 0.0, 0.0)))),
        "a step of .0.4 m in height between the lanes at the begin of road 2"),
    "wall across": (changed("<lanes>", f"<lateralProfile>{LEANING}</lateralProfile><lanes>"), "bank = -0.9"),
    "taper": (file(road("1", (Piece(100.0),), lanes([], [lane(-1)]).replace('b="0"', 'b="-0.04"'))),
              r"0.00 m wide in places, and too narrow from 36.5 m on, near road 1, lane -1, s = 3[67].0 m"),
    "no width": (changed('a="9.0"', 'a="-9"'), "the road is 0.00 m wide at most, at s = 0.0 m"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_that_makes_no_road_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    text, wanted = REFUSED[case]
    with pytest.raises(ValueError, match=r"^[^\n]{1,500}$") as refusal:
        course(tmp_path, text, "course.road=1", *(() if case == "footpath" else ("course.lane=-1",)))
    assert "road.xodr" in str(refusal.value)
    assert refusal.match(wanted)


# Lines between the lanes: where the file has them, as the driven lane sees them


MARKED: Final = '<roadMark sOffset="0" type="broken"/><roadMark sOffset="30" type="solid solid"/></lane>'


def four_lanes(*, marked: bool = False) -> str:
    """Two lanes each way, 4 m wide, and a shoulder on the right; lane -1's line is solid from 30 m on."""
    inside = lanes([lane(2), lane(1)], [lane(-1), lane(-2), lane(-3, kind="shoulder", width=2.0)])
    if marked:
        kerb = '<lane id="0" type="none"><roadMark sOffset="0" type="curb"/></lane>'
        inside = inside.replace('<lane id="0" type="none"/>', kerb)
        begin = inside.index('<lane id="-1"')
        inside = inside[:begin] + inside[begin:].replace("</lane>", MARKED, 1)
    return file(road("1", (Piece(60.0),), inside))


def lines_of(folder: Path, text: str, request: Request) -> FloatArray:
    lines = route(folder, text, request).lines
    assert lines is not None
    return lines


@pytest.mark.parametrize(
    ("number", "places", "solid"),
    [(-2, (-2, 2, 6, 10), -2), (-1, (-6, -2, 2, 6), -6), (1, (-2, 2, 6, 10), 10), (2, (2, 6, 10, 14), 14)],
)
def test_lines_lie_between_lanes_in_either_direction(
    tmp_path: Path, number: int, places: tuple[int, ...], solid: int
) -> None:
    """To the left of the driven lane's middle; broken without marks in the file, but solid beside the shoulder."""
    lines = lines_of(tmp_path, four_lanes(), Request(lane=number, edges="road"))
    expected = np.full((LINES, 2), np.nan)
    for place in places:
        expected[LINES // 2 + (place - 2) // 4] = place, float(place != solid)
    np.testing.assert_allclose(lines, np.broadcast_to(expected, lines.shape), atol=1e-12)


def test_the_marks_of_the_file_say_what_is_painted(tmp_path: Path) -> None:
    """The line between -1 and -2 is broken, then solid; a kerb is no line, and other borders are not marked."""
    lines = lines_of(tmp_path, four_lanes(marked=True), Request(lane=-1, edges="road"))
    right = LINES // 2 - 1
    assert np.flatnonzero(np.isfinite(lines[:, :, 0]).any(axis=0)).tolist() == [right]
    assert lines[:, right, 0] == pytest.approx(-2.0)
    assert lines[:, right, 1] == pytest.approx((np.arange(61) < 30).astype(float))
