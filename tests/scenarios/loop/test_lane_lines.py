"""Lines between the lanes of OpenDRIVE roads: where the file has them, as the driven lane sees them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pytest

from scenarios.roads.opendrive.file import read_opendrive
from scenarios.roads.opendrive.route import LINES, Request, lane_points
from tests.open_drive import Piece, file, lane, lanes, road
from vehicle.frames import FloatArray

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
    """Lines at the points of a route."""
    (folder / "road.xodr").write_text(text, encoding="utf-8")
    lines = lane_points(read_opendrive(folder / "road.xodr"), request, "road.xodr").lines
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


def test_a_lane_by_itself_has_no_lines(tmp_path: Path) -> None:
    (tmp_path / "road.xodr").write_text(four_lanes(), encoding="utf-8")
    assert lane_points(read_opendrive(tmp_path / "road.xodr"), Request(edges="lane"), "road.xodr").lines is None
