"""Lanes of OpenDRIVE files: where they go on, where they end and why, changes of lane; what is driven is judged."""

import math
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from scenarios.roads.opendrive.file import read_opendrive
from scenarios.roads.opendrive.links import stretches
from scenarios.roads.opendrive.route import lane_points
from scenarios.roads.opendrive.route_search import Request
from scenarios.roads.path_file import PathPoints
from tests.open_drive import TWO_LANES, Piece, Start, file, lane, lanes, road, sections
from vehicle.frames import FloatArray

SUCCESSOR: Final = '<successor id="{}"/>'
ONE: Final = lanes([], [lane(-1)])


def driven(folder: Path, text: str, **request: object) -> PathPoints:
    (folder / "road.xodr").write_text(text, encoding="utf-8")
    return lane_points(read_opendrive(folder / "road.xodr"), Request(**request), "road.xodr")  # type: ignore[arg-type]


def straight(inside: str, length: float = 100.0) -> str:
    return file(road("1", (Piece(length),), inside))


def offsets(*records: tuple[float, float]) -> str:
    return "".join(f'<laneOffset s="{s}" a="{a}" b="0" c="0" d="0"/>' for s, a in records)


@pytest.mark.parametrize("step", [4.0, -4.0, 0.05])
@pytest.mark.parametrize("late", [0.0, 1e-4])  # files are rounded
def test_a_jump_of_the_offset_where_lanes_are_renumbered_is_no_jump_of_the_lane(
    tmp_path: Path, step: float, late: float
) -> None:
    """The offset jumps by what an inner lane adds or takes: the lane that is driven is as straight as before."""
    inner = [lane(-1, width=abs(step))] if step > 0 else []
    before = (
        [lane(-1, width=-step), lane(-2, link=SUCCESSOR.format(-1))]
        if step < 0
        else [lane(-1, link=SUCCESSOR.format(-2))]
    )
    after = [*inner, lane(-2 if step > 0 else -1)]
    inside = sections((0.0, [], before), (60.0, [], after), offset=offsets((0.0, 0.0), (60.0 + late, step)))
    points = driven(tmp_path, straight(inside), lane=-1 if step > 0 else -2)
    assert np.ptp(points.places[:, 1]) < 1e-9
    assert points.places[-1, 0] == pytest.approx(100.0)


def test_a_jump_of_the_offset_within_a_section_is_a_gap_where_it_is_driven(tmp_path: Path) -> None:
    """No lane is renumbered there: the lane itself jumps."""
    text = straight(lanes([], [lane(-1)], offsets((0.0, 0.0), (60.0, 3.0))))
    with pytest.raises(ValueError, match=r"a gap of 3 m between the lanes at road 1, at s = 60.0 m"):
        driven(tmp_path, text)
    assert driven(tmp_path, text, length=50.0).places[-1, 0] == pytest.approx(50.0)


BROKEN: Final = {
    "kink": '<geometry s="50" x="50" y="500" hdg="0.9" length="50"><line/></geometry></planView>',
    "gap": '<geometry s="50" x="59" y="500" hdg="0" length="50"><line/></geometry></planView>',
    "nothing": "</planView>",
    "spiral": '<geometry s="50" x="50" y="500" hdg="0" length="50"><spiral curvStart="9" curvEnd="9"/></geometry>'
    "</planView>",
    "NaN": '<geometry s="50" x="nan" y="500" hdg="0" length="50"><line/></geometry></planView>',
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_road_that_is_not_driven_is_not_judged(tmp_path: Path, case: str) -> None:
    """Neither another road nor the part of the driven one that lies beyond the drive."""
    other = road("2", (Piece(50.0),), ONE, start=Start(0.0, 500.0)).replace("</planView>", BROKEN[case])
    if case == "nothing":
        other = '<road id="2" length="50" junction="-1"/>'
    text = file(road("1", (Piece(100.0),), ONE), other)
    assert driven(tmp_path, text).places[-1] == pytest.approx([100.0, -2.0])
    if case != "nothing":
        assert driven(tmp_path, text, road="2", length=45.0).places[-1] == pytest.approx([45.0, 498.0])
    if case in ("gap", "spiral", "NaN", "nothing"):
        with pytest.raises(ValueError, match="line 2"):
            driven(tmp_path, text, road="2")


def test_what_is_wrong_beside_the_drive_is_said(tmp_path: Path) -> None:
    bad = lane(-2).replace('a="4.0"', 'a="x"')
    points = driven(tmp_path, straight(lanes([], [lane(-1), bad])), lane=-1)
    (remark,) = points.remarks
    assert remark.startswith('course.file: near the drive, but not driven: line 2: road 1: <width sOffset="0">: a = ')


def test_pieces_of_no_length_are_skipped(tmp_path: Path) -> None:
    text = straight(ONE).replace(
        "<planView>", '<planView><geometry s="0" x="0" y="0" hdg="0" length="0"><line/></geometry>'
    )
    assert driven(tmp_path, text).places[-1, 0] == pytest.approx(100.0)


NEXT: Final = '<successor elementType="{}" elementId="{}" contactPoint="start"/>'


@pytest.mark.parametrize(
    ("link", "words"),
    [
        (NEXT.format("road", "77"), "linked to road 77, which is not in the file"),
        (NEXT.format("junction", "7"), "linked to junction 7, which is not in the file"),
        ("", "road 1 ends there"),
    ],
)
def test_a_drive_that_is_shorter_than_asked_for_is_said(tmp_path: Path, link: str, words: str) -> None:
    text = file(road("1", (Piece(150.0),), ONE, link=link))
    assert not driven(tmp_path, text, length=100.0).remarks
    (remark,) = driven(tmp_path, text, length=500.0).remarks
    assert "the drive is 150.0 m long, not course.length = 500 m" in remark
    assert words in remark
    assert bool(driven(tmp_path, text).remarks) is bool(link)


@pytest.mark.parametrize(("words", "end"), [(("1",), 50.0), (("1", "2"), 100.0), ((), 150.0), (("2",), 100.0)])
def test_a_route_ends_with_the_last_road_that_is_named(tmp_path: Path, words: tuple[str, ...], end: float) -> None:
    roads = [
        road(
            str(k), (Piece(50.0),), ONE, start=Start(50.0 * k - 50.0), link=NEXT.format("road", k + 1) if k < 3 else ""
        )
        for k in (1, 2, 3)
    ]
    assert driven(tmp_path, file(*roads), words=words).places[-1, 0] == pytest.approx(end)


@pytest.mark.parametrize("linked", [False, True])
@pytest.mark.parametrize("kind", ["sidewalk", "shoulder", "none", "border"])
def test_a_lane_goes_on_only_where_vehicles_may_drive(tmp_path: Path, kind: str, *, linked: bool) -> None:
    first = [lane(-1, link=SUCCESSOR.format(-1)), lane(-2, link=SUCCESSOR.format(-2) if linked else "")]
    text = straight(sections((0.0, [], first), (60.0, [], [lane(-1), lane(-2, kind=kind)])))
    ends = rf"lane -2 of road 1 ends at s = 60.0 m, \(60.00, -6.00\): lane -2 there is a lane of the type {kind}"
    with pytest.raises(ValueError, match=ends + r".*course.route = 1,lane -1"):
        driven(tmp_path, text, lane=-2)
    assert driven(tmp_path, text, lane=-2, length=60.0).places[-1, 0] == pytest.approx(60.0)
    assert driven(tmp_path, text).places[-1] == pytest.approx([100.0, -2.0])  # the longest drive


def test_a_lane_without_a_link_goes_on_where_it_touches(tmp_path: Path) -> None:
    """The lane is renumbered and nothing says so: its borders do."""
    text = straight(
        sections((0.0, [], [lane(-1), lane(-2)]), (60.0, [], [lane(-1, width=2.0), lane(-2, width=2.0), lane(-3)]))
    )
    assert driven(tmp_path, text, lane=-2).places[-1] == pytest.approx([100.0, -6.0])


def direct(turn: float, *, ahead: float = 0.0) -> str:
    """A motorway that parts: road 2 goes straight on and bends later by a right angle, road 3 bends at once."""
    link = '<successor elementType="junction" elementId="9"/>'
    later = (Piece(300.0, ahead), Piece(150.0 * math.pi, math.copysign(1.0 / 300.0, turn)))
    ways = "".join(
        f'<connection id="{k}" incomingRoad="1" linkedRoad="{k}" contactPoint="start"><laneLink from="-1" to="-1"/>'
        "</connection>"
        for k in (2, 3)
    )
    return file(
        road("1", (Piece(100.0),), ONE, link=link),
        road("2", later, ONE, start=Start(100.0)),
        road("3", (Piece(200.0, turn),), ONE, start=Start(100.0)),
        f'<junction id="9" type="direct">{ways}</junction>',
    )


@pytest.mark.parametrize(
    ("turn", "word", "end"), [(-0.005, "straight", 2), (-0.005, "right", 3), (0.005, "left", 3), (0.005, "straight", 2)]
)
def test_ways_of_a_direct_junction_are_told_apart_by_their_first_metres(
    tmp_path: Path, turn: float, word: str, end: int
) -> None:
    text = direct(turn)
    assert driven(tmp_path, text, words=(word,)).places[-1] == pytest.approx(
        driven(tmp_path, text, words=("1", str(end))).places[-1]
    )
    other = "left" if turn < 0.0 else "right"
    with pytest.raises(ValueError, match=f"junction 9: course.route = {other} fits no way"):
        driven(tmp_path, text, words=(other,))


@pytest.mark.parametrize(
    ("turns", "words"),
    [
        ((0.006, -0.006), ("left", "right")),  # a fork
        ((-0.002, -0.006), ("straight", "right")),  # a main road that bends, and its exit
        ((0.0, 0.006), ("straight", "left")),
    ],
)
@pytest.mark.parametrize("own_lanes", [False, True])
def test_each_way_has_a_word_from_whichever_lane_it_begins(
    tmp_path: Path, turns: tuple[float, float], words: tuple[str, str], *, own_lanes: bool
) -> None:
    """Ways of a lane of their own are compared with those of the lanes beside it."""
    two, link = lanes([], [lane(-1), lane(-2)]), '<successor elementType="junction" elementId="9"/>'
    order = (2, 3) if turns[0] >= turns[1] else (3, 2)  # the way on the left begins on the left lane
    roads, ways = [road("1", (Piece(100.0),), two if own_lanes else ONE, link=link)], ""
    for name, turn in zip((2, 3), turns, strict=True):
        number = -1 - order.index(name) if own_lanes else -1
        start = Start(100.0, 4.0 * (number + 1))
        roads.append(road(str(name), (Piece(80.0, turn),), ONE, start=start))
        ways += f'<connection id="{name}" incomingRoad="1" linkedRoad="{name}" contactPoint="start">'
        ways += f'<laneLink from="{number}" to="-1"/></connection>'
    text = file(*roads, f'<junction id="9" type="direct">{ways}</junction>')
    for name, word in zip((2, 3), words, strict=True):
        number = -1 - order.index(name) if own_lanes else -1
        ends = [driven(tmp_path, text, road="1", lane=number, words=(one,)).places[-1] for one in (word, str(name))]
        assert ends[0] == pytest.approx(ends[1])


TRAVEL: Final = '<userData><vectorLane travelDir="{}"/></userData></lane>'


@pytest.mark.parametrize(
    ("old", "new", "begins"),
    [
        ("<lane id", '<lane direction="standard" id', 0.0),
        ("<lane id", '<lane direction="reversed" id', 100.0),
        ("<lane id", '<lane direction="both" id', 0.0),
        ("</lane>", TRAVEL.format("forward"), 0.0),
        ("</lane>", TRAVEL.format("backward"), 100.0),
        ("</lane>", TRAVEL.format("undirected"), 0.0),
    ],
)
def test_lanes_are_driven_the_way_that_the_file_says(tmp_path: Path, old: str, new: str, begins: float) -> None:
    """OpenDRIVE 1.8 and RoadRunner; ``travelDir`` is along the reference line."""
    text = straight(lanes([], [lane(-1).replace(old, new)]))
    assert driven(tmp_path, text).places[0] == pytest.approx([begins, -2.0])


def test_no_route_leads_onto_a_lane_that_goes_the_other_way(tmp_path: Path) -> None:
    reversed_lane = lane(-1).replace("<lane id", '<lane direction="reversed" id')
    text = straight(sections((0.0, [], [lane(-1)]), (60.0, [], [reversed_lane])))
    with pytest.raises(ValueError, match="lane -1 there goes the other way"):
        driven(tmp_path, text, road="1", lane=-1)


GROWS: Final = '<width sOffset="0" a="0" b="0.08" c="0" d="0"/><width sOffset="50" a="4" b="0" c="0" d="0"/>'
GROWING: Final = f'<lane id="-2" type="{{}}">{GROWS}</lane>'


def exit_lane(kind: str = "exit") -> str:
    """A lane that begins 100 m on and is 4 m wide after 50 m."""
    first = lane(-1, link=SUCCESSOR.format(-1))
    return straight(sections((0.0, [], [first]), (100.0, [], [lane(-1), GROWING.format(kind)])), 300.0)


def test_a_drive_may_begin_where_a_lane_does(tmp_path: Path) -> None:
    """As soon as it is as wide as the vehicle: 2.6 m are 32.5 m on."""
    points = driven(tmp_path, exit_lane(), lane=-2, narrowest=2.6)
    assert points.places[0, 0] == pytest.approx(133.0, abs=1.0)
    assert points.places[-1] == pytest.approx([300.0, -6.0])


@pytest.mark.parametrize(
    ("word", "begin", "over"),
    [("lane -2 from 120", 120.0, 50.0), ("lane -2 from 120 over 80", 120.0, 80.0), ("lane -2", 132.0, 50.0)],
)
def test_a_lane_is_changed_where_and_as_slowly_as_asked(tmp_path: Path, word: str, begin: float, over: float) -> None:
    """It is still on its lane at the begin, half way between in the middle, and on the other lane after it."""
    places = driven(tmp_path, exit_lane(), words=("1", word)).places

    def aside(x: float) -> float:
        return float(np.interp(x, places[:, 0], places[:, 1]))

    assert aside(begin) == pytest.approx(-2.0, abs=0.02)
    assert -6.0 < aside(begin + 0.5 * over) < -2.0
    assert aside(begin + 1.15 * over) == pytest.approx(
        -4.0 - 0.5 * min(4.0, 0.08 * (begin + 1.15 * over - 100.0)), abs=0.02
    )
    slopes = np.diff(places[:, 1]) / np.diff(places[:, 0])
    assert np.abs(np.diff(slopes)).max() < 0.05  # the lane itself has corners of 0.04


@pytest.mark.parametrize(
    ("word", "kind", "reason"),
    [
        (
            "lane -2 from 30",
            "exit",
            "road 1 has the lanes -1 from s = 0.0 to 100.0 m; -2, -1 from s = 100.0 to 300.0 m",
        ),
        ("lane -3", "exit", "road 1 has the lanes"),
        ("lane -2", "sidewalk", "it is a lane of the type sidewalk"),
        ("lane two", "exit", "the file has no such road"),
        ("lane -2 from 1.2.3", "exit", "a number is expected"),
    ],
)
def test_a_change_of_lane_that_cannot_be_is_refused(tmp_path: Path, word: str, kind: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        driven(tmp_path, exit_lane(kind), words=("1", word))


@pytest.mark.parametrize("merge", [False, True])
def test_a_lane_that_splits_in_two_or_two_that_merge_are_driven(tmp_path: Path, *, merge: bool) -> None:
    """The wide lane leaves room for the way aside; the narrow one is driven in its middle."""
    wide = [lane(-1, width=8.0, link='<predecessor id="-1"/>' if merge else SUCCESSOR.format(-1))]
    narrow = [lane(-1, link=SUCCESSOR.format(-1) if merge else '<predecessor id="-1"/>'),
              lane(-2, link=SUCCESSOR.format(-1) if merge else '<predecessor id="-1"/>')]  # fmt: skip
    parts = (narrow, wide) if merge else (wide, narrow)
    text = straight(sections((0.0, [], parts[0]), (100.0, [], parts[1])), 200.0)
    for number, y in ((-1, -2.0), (-2, -6.0)):
        if merge:
            places = driven(tmp_path, text, lane=number).places
        else:
            places = driven(tmp_path, text, words=() if number == -1 else ("1", "lane -2")).places
        assert places[:, 1].min() > min(y, -4.0) - 1e-6  # without a swing to the other side
        assert places[:, 1].max() < max(y, -4.0) + 1e-6
        beside = places[(places[:, 0] < 99.0) if merge else (places[:, 0] > 155.0)]
        assert beside[:, 1] == pytest.approx(y, abs=1e-6)
        assert places[-1 if merge else 0, 1] == pytest.approx(-4.0)
        assert np.abs(np.diff(places[:, 1])).max() < 0.25


@pytest.mark.parametrize("of_roads", [False, True])
def test_of_several_lanes_that_follow_the_wanted_one_is_driven(tmp_path: Path, *, of_roads: bool) -> None:
    """Links of lanes name all that a lane splits into, in a road, or from a road to the next."""
    wide, narrow = [lane(-1, width=8.0, link=SUCCESSOR.format(-1) + SUCCESSOR.format(-2))], [lane(-1), lane(-2)]
    text = straight(sections((0.0, [], wide), (100.0, [], narrow)), 200.0)
    if of_roads:
        after = road("2", (Piece(100.0),), lanes([], narrow), start=Start(100.0, 0.0))
        text = file(road("1", (Piece(100.0),), lanes([], wide), link=NEXT.format("road", "2")), after)
    for words, y in (((), -2.0), (("1", "lane -2"), -6.0), (("1", "lane -1"), -2.0)):
        assert driven(tmp_path, text, road="1", words=words).places[-1] == pytest.approx([200.0, y])


VIRTUAL: Final = '<{} elementType="road" elementId="1" elementS="80" elementDir="+"/>'
QUARTER: Final = (Piece(0.5 * math.pi * 48.0, -1.0 / 48.0), Piece(3.0))  # to the right


@pytest.mark.parametrize(
    ("start", "lane_", "words", "end"),
    [
        ("1", -1, (), (200.0, -2.0)),
        ("1", -1, ("1", "2"), (126.0, -51.0)),
        ("1", -1, ("1", "2", "3"), (126.0, -101.0)),
        ("1", 1, ("1", "2"), None),
        ("4", -1, (), (200.0, -2.0)),
    ],
)
def test_virtual_junctions_are_passed_left_and_joined(
    tmp_path: Path, start: str, lane_: int, words: tuple[str, ...], end: tuple[float, float] | None
) -> None:
    """At s = 80 m of road 1 road 2 leaves it, towards road 3, and road 4 joins it, by quarters of circles."""
    link = VIRTUAL.format("predecessor") + NEXT.format("road", "3")
    text = file(
        road("1", (Piece(200.0),), TWO_LANES),
        road("2", QUARTER, ONE, start=Start(80.0, 0.0), link=link, junction="9"),
        road("3", (Piece(50.0),), ONE, start=Start(128.0, -51.0, -0.5 * math.pi)),
        road("4", QUARTER[:1], ONE, start=Start(32.0, -48.0, 0.5 * math.pi), link=VIRTUAL.format("successor")),
        '<junction id="9" type="virtual" mainRoad="1" sStart="75" sEnd="90" orientation="+"/>',
    )
    if end is None:
        with pytest.raises(ValueError, match=r"course.route = 2 is not reached: road 1 ends there"):
            driven(tmp_path, text, road=start, lane=lane_, words=words)
        return
    assert driven(tmp_path, text, road=start, lane=lane_, words=words).places[-1] == pytest.approx(end)


def test_the_longest_drive_is_the_default(tmp_path: Path) -> None:
    """Not the first road, no lane of no width, no road that is refused; of lanes as long the outermost for all."""
    link = NEXT.format("road", "9")
    text = file(
        road("1", (Piece(20.0),), TWO_LANES),
        road("2", (Piece(300.0),), lanes([], [lane(-1, width=0.0)]), start=Start(0.0, 50.0)),
        road(
            "3",
            (Piece(100.0),),
            lanes([], [lane(-1), lane(-2), lane(-3, kind="bus"), lane(-4, kind="sidewalk")]),
            start=Start(0.0, 90.0),
        ),
        road("4", (Piece(100.0),), ONE, start=Start(0.0, 130.0), link=link),
        road("9", (Piece(100.0),), ONE, start=Start(110.0, 130.0)),
    )
    points = driven(tmp_path, text)
    assert points.places[0] == pytest.approx([0.0, 84.0])
    assert "a gap of 10 m between the lanes at the begin of road 9" in points.remarks[0]


def test_lanes_are_listed_by_section(tmp_path: Path) -> None:
    text = straight(sections((0.0, [], [lane(-1)]), (60.0, [lane(1)], [lane(-1), lane(-2)])))
    with pytest.raises(
        ValueError, match=r"course.lane = 7: road 1 has the lanes -1 from s = 0.0 to 60.0 m; -2, -1, 1 from"
    ):
        driven(tmp_path, text, road="1", lane=7)


def test_stretches_say_what_can_be_driven_and_why_not(tmp_path: Path) -> None:
    (tmp_path / "road.xodr").write_text(exit_lane(), encoding="utf-8")
    straight_on, narrow, wide = stretches(read_opendrive(tmp_path / "road.xodr"), 2.6)
    begin = wide.begin
    assert begin == pytest.approx(133.0, abs=1.0)
    assert straight_on == ("1", -1, 0.0, 300.0, None)
    assert narrow == ("1", -2, 100.0, begin, "the lane is 0.00 m wide: must be at least 2.6 m")
    assert wide == ("1", -2, begin, 300.0, None)


def test_borders_of_the_lane_and_edges_of_the_road_are_both_known(tmp_path: Path) -> None:
    """A shoulder of 2 m on the right, an oncoming lane on the left."""
    points = driven(tmp_path, straight(lanes([lane(1)], [lane(-1), lane(-2, kind="shoulder", width=2.0)])), lane=-1)
    count = len(points.places)
    for found, sides in ((points.lanes, (2.0, 2.0)), (points.paved, (6.0, 4.0)), (points.widths, (2.0, 2.0))):
        assert found == pytest.approx(np.tile(sides, (count, 1)))


def lines_at(points: PathPoints, row: int) -> FloatArray:
    assert points.lines is not None
    line: FloatArray = points.lines[row, :, 0]
    return line[np.isfinite(line)]


def test_lines_stay_where_they_are_while_the_lane_is_changed(tmp_path: Path) -> None:
    """The line between both lanes lies 4 m to the right of the road's middle, wherever the path is."""
    points = driven(tmp_path, straight(lanes([], [lane(-1), lane(-2)])), words=("1", "lane -2 from 20"), lane=-1)
    for row in range(len(points.places)):
        assert points.places[row, 1] + lines_at(points, row) == pytest.approx([-4.0], abs=0.01)
    assert points.lines is not None
    assert np.flatnonzero(np.isfinite(points.lines[:, :, 0]).all(axis=0)).size == 1  # with one number throughout


def through(contact: str, rule: str) -> str:
    """Roads 1 and 2 in line with a junction between them, whose road runs along or against the drive."""
    along = contact == "start"
    side = -1 if rule == "RHT" else 1  # of lanes that go along the reference line
    name = ("predecessor", "successor") if along else ("successor", "predecessor")
    to = '<{} elementType="road" elementId="{}" contactPoint="{}"/>'
    links = to.format(name[0], "1", "end") + to.format(name[1], "2", "start")
    own = side if along else -side
    lane_link = f'<predecessor id="{side}"/><successor id="{side}"/>'
    way = lanes(*(([lane(own, link=lane_link)], []) if own > 0 else ([], [lane(own, link=lane_link)])))
    begin = Start(50.0) if along else Start(80.0, 0.0, math.pi)
    junction = '<successor elementType="junction" elementId="9"/>'
    connection = (
        f'<connection id="0" incomingRoad="1" connectingRoad="3" contactPoint="{contact}">'
        f'<laneLink from="{side}" to="{own}"/></connection>'
    )
    text = file(
        road("1", (Piece(50.0),), TWO_LANES, link=junction),
        road("2", (Piece(50.0),), TWO_LANES, start=Start(80.0)),
        road("3", (Piece(30.0),), way, start=begin, link=links, junction="9"),
        f'<junction id="9">{connection}</junction>',
    )
    return text.replace("<road ", f'<road rule="{rule}" ')


@pytest.mark.parametrize("rule", ["RHT", "LHT"])
@pytest.mark.parametrize("contact", ["start", "end"])
@pytest.mark.parametrize("stated", [True, False])
def test_a_connecting_road_is_driven_along_or_against_its_line(
    tmp_path: Path, contact: str, rule: str, *, stated: bool
) -> None:
    """Also where the connection does not say which end it begins at."""
    text = through(contact, rule)
    old = f'connectingRoad="3" contactPoint="{contact}"'
    points = driven(tmp_path, text if stated else text.replace(old, 'connectingRoad="3"'), road="1")
    assert points.places[0] == pytest.approx([0.0, -2.0 if rule == "RHT" else 2.0])
    assert points.places[-1] == pytest.approx([130.0, -2.0 if rule == "RHT" else 2.0])


BORDERS: Final = (
    '<lane id="-1" type="driving"><border sOffset="0" a="4" b="0" c="0" d="0"/></lane>'
    '<lane id="-2" type="driving"><border sOffset="0" a="7" b="0" c="0" d="0"/></lane>'
)


@pytest.mark.parametrize(
    ("inside", "request_", "end"),
    [
        (lanes([], [BORDERS]), {"lane": -2}, (100.0, -5.5)),
        (lanes([lane(1)], []), {}, (0.0, 2.0)),  # on one side alone, against the line
        (lanes([], [lane(-1).replace("<lane ", '<lane level="true" ')]), {}, (100.0, -2.0)),
        (sections((0.0, [], [lane(-1)]), (100.0, [], [lane(-1)])), {}, (100.0, -2.0)),  # a section of no length
        (sections((0.0, [], [lane(-1)]), (60.0, [], [lane(-1)]), (60.0, [], [lane(-1)])), {}, (100.0, -2.0)),
    ],
)
def test_features_of_other_files_are_driven(
    tmp_path: Path, inside: str, request_: dict[str, int], end: tuple[float, float]
) -> None:
    text = straight(inside).replace(
        "<header", "<header><geoReference><![CDATA[+proj=utm <>]]></geoReference></header><old"
    )
    assert driven(tmp_path, text, **request_).places[-1] == pytest.approx(end)


CORNERS: Final = "".join(f'<cornerRoad s="{s}" t="{t}"/>' for s, t in ((50, 0), (54, 0), (54, 1), (50, 1)))
LOCAL: Final = "".join(f'<cornerLocal u="{u}" v="{v}"/>' for u, v in ((0, 0), (2, 0), (2, 1)))
THINGS: Final = {
    '<signals><signal id="1" s="10" t="-3"/></signals>': ("signal", [(10.0, -3.0)]),
    f'<objects><object type="trafficIsland" s="50" t="0"><outline>{CORNERS}</outline></object></objects>': (
        "trafficIsland",
        [(50.0, 0.0), (54.0, 0.0), (54.0, 1.0), (50.0, 1.0)],
    ),
    f'<objects><object type="a" s="50" t="2" hdg="{math.pi / 2}"><outlines><outline>{LOCAL}</outline></outlines>'
    "</object></objects>": ("a", [(50.0, 2.0), (50.0, 4.0), (49.0, 4.0)]),
    '<objects><object type="curb" s="0" t="4"><repeat s="10" length="2" tStart="4" tEnd="5"/></object></objects>': (
        "curb",
        [(10.0, 4.0), (12.0, 5.0)],
    ),
    '<objects><object type="building" s="20" t="9" length="4" width="2"/></objects>': (
        "building",
        [(22.0, 10.0), (22.0, 8.0), (18.0, 8.0), (18.0, 10.0)],
    ),
    '<objects><object type="tree" s="20" t="x"/></objects>': None,
}


@pytest.mark.parametrize("inside", THINGS)
def test_things_beside_the_road_are_known_for_plans(tmp_path: Path, inside: str) -> None:
    """Signals, and objects by their corners along the road or their own axes, their size, or as a row."""
    (tmp_path / "road.xodr").write_text(straight(ONE + inside), encoding="utf-8")
    things = list(read_opendrive(tmp_path / "road.xodr").roads["1"].things())
    wanted = THINGS[inside]
    assert [thing.kind for thing in things] == ([wanted[0]] if wanted else [])
    for thing in things:
        assert wanted is not None
        closed = [*wanted[1], wanted[1][0]] if len(wanted[1]) > 2 else wanted[1]
        assert thing.outline == pytest.approx(np.array(closed))
