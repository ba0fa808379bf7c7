"""Nearest-descriptor search within a window, by the sum of absolute differences."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.odometry.viso2_features import Features
from vehicle.frames import FloatArray

# Size of the grid cells as shares of the window: smaller cells cost more look-ups, larger cells more comparisons.
_WIDE = 0.125
_HIGH = 0.25

Indices = NDArray[np.int64]


class Placed(NamedTuple):
    """Features with their measured or predicted positions."""

    features: Features
    position: FloatArray  # (n, 2) [px]


class Window(NamedTuple):
    """Search window around a predicted position."""

    left: float  # [px]
    right: float  # [px]
    rows: float  # above and below [px]


def most_similar(queries: Placed, candidates: Placed, window: Window) -> Indices:
    """Index (n,) of the candidate of the same kind with the most similar descriptor; -1 if the window has none."""
    one, other = _pairs_in_windows(queries, candidates, window)
    best = np.full(len(queries.position), -1, np.int64)
    if len(one) == 0:
        return best
    ours = np.take(queries.features.descriptors, one, axis=0)
    theirs = np.take(candidates.features.descriptors, other, axis=0)
    difference = cv2.absdiff(ours, theirs, dst=ours)
    cost = cv2.reduce(difference, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel().astype(np.int64)
    cost *= len(candidates.position)
    cost += other  # among equal descriptors the first one wins
    first = np.concatenate([[0], np.flatnonzero(one[1:] != one[:-1]) + 1])
    best[one[first]] = np.minimum.reduceat(cost, first) % len(candidates.position)
    return best


def _pairs_in_windows(queries: Placed, candidates: Placed, window: Window) -> tuple[Indices, Indices]:
    """All pairs of one kind in which the candidate lies in the window of the query, sorted by the query.

    Candidates are sorted into the cells of a grid. The cells of a window are contiguous in every row of the grid.
    """
    nothing = np.zeros(0, np.int64), np.zeros(0, np.int64)
    if len(queries.position) == 0 or len(candidates.position) == 0:
        return nothing
    position, candidate_position = _as_complex(queries.position), _as_complex(candidates.position)
    u, v, u_candidate, v_candidate = position.real, position.imag, candidate_position.real, candidate_position.imag
    low_u, high_u = max(u.min() - window.left, u_candidate.min()), min(u.max() + window.right, u_candidate.max())
    low_v, high_v = max(v.min() - window.rows, v_candidate.min()), min(v.max() + window.rows, v_candidate.max())
    if low_u > high_u or low_v > high_v:
        return nothing
    per_column = 1.0 / max(_WIDE * (window.left + window.right), 1.0)
    per_row = 1.0 / max(_HIGH * 2.0 * window.rows, 1.0)
    height = math.ceil(2.0 * window.rows * per_row) + 1  # of a window [cells]
    columns, rows = int((high_u - low_u) * per_column) + 1, int((high_v - low_v) * per_row) + 1
    inside = np.flatnonzero(
        (u_candidate >= low_u) & (u_candidate <= high_u) & (v_candidate >= low_v) & (v_candidate <= high_v)
    )
    column, row = (u_candidate[inside] - low_u) * per_column, (v_candidate[inside] - low_v) * per_row
    # each kind has empty rows below, so that a window never reaches the next kind
    first_row = (rows + height) * np.arange(int(max(queries.features.kind.max(), candidates.features.kind.max())) + 2)
    number = (first_row[candidates.features.kind[inside]] + row.astype(np.int64)) * columns + column.astype(np.int64)
    order = inside[np.argsort(number, kind="stable")]
    start = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=first_row[-1] * columns))])
    first = _cells((u - window.left - low_u) * per_column, columns)
    behind = _cells((u + window.right - low_u) * per_column + 1.0, columns)
    top = _cells((v - window.rows - low_v) * per_row, rows)
    cell = ((first_row[queries.features.kind] + top)[:, None] + np.arange(height)) * columns
    begin, end = start.take(cell + first[:, None]).ravel(), start.take(cell + behind[:, None]).ravel()
    filled = np.flatnonzero(end > begin)
    if len(filled) == 0:
        return nothing
    one, index = _ranges(filled // height, begin[filled], end[filled])
    other = order.take(index)
    middle, half = 0.5 * (window.right - window.left), 0.5 * (window.right + window.left)
    off = candidate_position.take(other) - position.take(one)
    off -= np.complex64(middle)
    near = np.flatnonzero((np.abs(off.real) <= half) & (np.abs(off.imag) <= window.rows))
    return one.take(near), other.take(near)


def _ranges(owner: Indices, begin: Indices, end: Indices) -> tuple[Indices, Indices]:
    """Concatenated ranges (none empty), and for each number the owner of its range.

    Computed by cumulative sums, which are faster in NumPy than ``repeat``.
    """
    behind = np.cumsum(end - begin)
    owners, numbers = np.zeros(behind[-1], np.int64), np.ones(behind[-1], np.int64)
    owners[0], numbers[0] = owner[0], begin[0]
    owners[behind[:-1]], numbers[behind[:-1]] = np.diff(owner), begin[1:] - end[:-1] + 1
    return np.cumsum(owners), np.cumsum(numbers)


def _as_complex(positions: FloatArray) -> NDArray[np.complex64]:
    """Positions as u + i v: one number per point is fetched faster, and there are a hundred thousand pairs."""
    return np.ascontiguousarray(positions, dtype=np.float32).view(np.complex64)[:, 0]


def _cells(index: NDArray[np.float32], count: int) -> Indices:
    """Cell indices, clipped to 0 ... ``count``, of coordinates in units of a cell."""
    return np.clip(np.floor(index), 0.0, count).astype(np.int64)
