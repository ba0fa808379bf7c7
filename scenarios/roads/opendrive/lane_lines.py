"""Lines painted between the lanes of a road, seen along the middle of one lane.

Each place along that lane has a row of ``LINES`` lines, from right to left. The line on the lane's right is number
``LINES // 2 - 1``, the one on its left comes next, wherever the road gets or loses lanes beside them.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from scenarios.roads.opendrive.network import LineKind, Section
from vehicle.frames import FloatArray

LINES: Final = 18


def lines_between(section: Section, lane: int, others: list[int], s: FloatArray, middle: FloatArray) -> FloatArray:
    """Lines between neighbouring lanes (n, LINES, 2) at s (n,) [m]; NaN where there is none.

    Args:
        section: of the road.
        lane: id of the lane that is driven.
        others: ids of the lanes that have lines between them, rising; among them ``lane``.
        s: [m].
        middle: of the lane, to the left of lane 0 (n,) [m].

    Returns:
        For each line its place to the left of ``middle`` [m], and 1 for a broken line or 0 for a solid one.
    """
    lines = np.full((len(s), LINES, 2), np.nan)
    left_of_lane = LINES // 2
    for k, (right, left) in enumerate(pairwise(others)):
        number = left_of_lane + k - others.index(lane)
        if not 0 <= number < LINES:
            continue
        inner = 0 if right < 0 < left else min(right, left, key=abs)  # the line is on this lane's outer border
        _, border = section.borders(s, inner)
        kinds = section.line_kinds(s, inner, (right, left))
        shown = kinds != LineKind.NONE
        lines[shown, number, 0] = (border if inner > 0 else -border)[shown] - middle[shown]
        lines[shown, number, 1] = kinds[shown] == LineKind.BROKEN
    return lines


def seen_backwards(lines: FloatArray) -> FloatArray:
    """Lines (n, LINES, 2) in the order and with the signs of travel against the reference line."""
    return np.asarray(lines[:, ::-1] * np.array([-1.0, 1.0]))
