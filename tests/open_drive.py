"""Small OpenDRIVE files, made of pieces whose ends are closed forms."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

WIDTH: Final = 4.0  # of a lane [m]


class Piece(NamedTuple):
    """A line or an arc."""

    length: float  # [m]
    curvature: float = 0.0  # [1/m]


class Start(NamedTuple):
    """Where a reference line begins."""

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0


ORIGIN: Final = Start()


def plan(pieces: Sequence[Piece], start: Start = ORIGIN) -> str:
    """The plan view of lines and arcs one after the other."""
    s, (x, y, heading) = 0.0, start
    rows = []
    for length, k in pieces:
        shape = f'<arc curvature="{k!r}"/>' if k else "<line/>"
        rows.append(f'<geometry s="{s!r}" x="{x!r}" y="{y!r}" hdg="{heading!r}" length="{length!r}">{shape}</geometry>')
        turn = k * length
        ahead, aside = (math.sin(turn) / k, (1.0 - math.cos(turn)) / k) if k else (length, 0.0)
        x += ahead * math.cos(heading) - aside * math.sin(heading)
        y += ahead * math.sin(heading) + aside * math.cos(heading)
        s, heading = s + length, heading + turn
    return f"<planView>{''.join(rows)}</planView>"


def lane(number: int, *, width: float = WIDTH, kind: str = "driving", link: str = "") -> str:
    """A lane of one width."""
    size = f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/>'
    return f'<lane id="{number}" type="{kind}">{f"<link>{link}</link>" if link else ""}{size}</lane>'


def lanes(left: Sequence[str], right: Sequence[str], offset: str = "") -> str:
    """The lanes of a road of one section."""
    sides = f'<left>{"".join(left)}</left><center><lane id="0" type="none"/></center><right>{"".join(right)}</right>'
    return f'<lanes>{offset}<laneSection s="0">{sides}</laneSection></lanes>'


def sections(*parts: tuple[float, Sequence[str], Sequence[str]], offset: str = "") -> str:
    """The lanes of a road: where each section begins, its left and its right lanes."""
    inside = "".join(
        lanes(left, right).replace('laneSection s="0"', f'laneSection s="{s}"') for s, left, right in parts
    )
    return f"<lanes>{offset}{inside.replace('<lanes>', '').replace('</lanes>', '')}</lanes>"


def road(
    name: str, pieces: Sequence[Piece], inside: str, *, start: Start = ORIGIN, link: str = "", junction: str = "-1"
) -> str:
    """A road; ``inside`` are its profiles and lanes."""
    length = sum(piece.length for piece in pieces)
    links = f"<link>{link}</link>" if link else ""
    return f'<road id="{name}" length="{length!r}" junction="{junction}">{links}{plan(pieces, start)}{inside}</road>'


def file(*elements: str) -> str:
    """An OpenDRIVE file."""
    return f'<?xml version="1.0"?>\n<OpenDRIVE><header revMajor="1" revMinor="6"/>{"".join(elements)}</OpenDRIVE>\n'


TWO_LANES: Final = lanes([lane(1)], [lane(-1)])


def bend(radius: float, turn: float, *, width: float = 9.0, before: float = 30.0, after: float = 30.0) -> str:
    """A straight, an arc to the left by ``turn`` [rad] and a straight, as the middle of the only lane."""
    inner = radius - 0.5 * width  # the lane is on the right of the reference line
    pieces = (Piece(before), Piece(inner * turn, 1.0 / inner), Piece(after))
    return file(road("1", pieces, lanes([], [lane(-1, width=width)])))


def crossing() -> str:
    """Roads 1 from the west, 2 to the east, 3 to the north and 4 to the south, each 50 m, round a junction of 40 m.

    Of the lane that comes from the west there is a way straight on (12), to the left (13) and to the right (14).
    """
    to, half = '<{} elementType="{}" elementId="{}" contactPoint="{}"/>', 0.5 * math.pi
    ways = {
        "2": (Piece(40.0),),
        "3": (Piece(8.0), Piece(half * 12.0, 1.0 / 12.0), Piece(8.0)),
        "4": (Piece(8.0), Piece(half * 12.0, -1.0 / 12.0), Piece(8.0)),
    }
    starts = {"2": Start(40.0, 0.0, 0.0), "3": Start(20.0, 20.0, half), "4": Start(20.0, -20.0, -half)}
    junction = '<successor elementType="junction" elementId="9"/>'
    roads = [road("1", (Piece(50.0),), TWO_LANES, start=Start(-50.0, 0.0, 0.0), link=junction)]
    connections = ""
    for k, (name, pieces) in enumerate(ways.items()):
        roads.append(road(name, (Piece(50.0),), TWO_LANES, start=starts[name]))
        link = to.format("predecessor", "road", "1", "end") + to.format("successor", "road", name, "start")
        roads.append(road(f"1{name}", pieces, lanes([], [lane(-1)]), link=link, junction="9"))
        way = f'incomingRoad="1" connectingRoad="1{name}" contactPoint="start"'
        connections += f'<connection id="{k}" {way}><laneLink from="-1" to="-1"/></connection>'
    return file(*roads, f'<junction id="9">{connections}</junction>')
