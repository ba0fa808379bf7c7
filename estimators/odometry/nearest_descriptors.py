"""For features of one image the most similar ones of another within a window, by sums of absolute differences."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.odometry.viso2_features import Features
from vehicle.frames import FloatArray

# Cells that features are sorted into, as shares of the window: smaller ones cost more look-ups, larger ones more
# features that are looked at in vain.
_WIDE = 0.125
_HIGH = 0.25

Indices = NDArray[np.int64]


class Placed(NamedTuple):
    """Features and where they are, or are expected to be."""

    features: Features
    at: FloatArray  # (n, 2) [px]


class Window(NamedTuple):
    """Where to look, from where a feature is expected."""

    left: float  # [px]
    right: float  # [px]
    rows: float  # above and below [px]


def most_similar(sought: Placed, others: Placed, window: Window) -> Indices:
    """Index (n,) of the other of the same kind that looks most like each one that is sought; -1 if none is there."""
    one, other = _candidates(sought, others, window)
    best = np.full(len(sought.at), -1, np.int64)
    if len(one) == 0:
        return best
    ours, theirs = (np.take(f.descriptors, i, axis=0) for f, i in ((sought.features, one), (others.features, other)))
    apart = cv2.absdiff(ours, theirs, dst=ours)
    misfit = cv2.reduce(apart, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel().astype(np.int64)
    misfit *= len(others.at)
    misfit += other  # of equal ones the first in the list
    first = np.concatenate([[0], np.flatnonzero(one[1:] != one[:-1]) + 1])
    best[one[first]] = np.minimum.reduceat(misfit, first) % len(others.at)
    return best


def _candidates(sought: Placed, others: Placed, window: Window) -> tuple[Indices, Indices]:
    """All pairs of one kind with the other in the window of the one, sorted by the one.

    The others are sorted into cells of a grid; in every row of cells those to be looked at follow one another.
    """
    nothing = np.zeros(0, np.int64), np.zeros(0, np.int64)
    if len(sought.at) == 0 or len(others.at) == 0:
        return nothing
    at, at_others = _places(sought.at), _places(others.at)
    u, v, u_others, v_others = at.real, at.imag, at_others.real, at_others.imag
    low_u, high_u = max(u.min() - window.left, u_others.min()), min(u.max() + window.right, u_others.max())
    low_v, high_v = max(v.min() - window.rows, v_others.min()), min(v.max() + window.rows, v_others.max())
    if low_u > high_u or low_v > high_v:
        return nothing
    per_column = 1.0 / max(_WIDE * (window.left + window.right), 1.0)
    per_row = 1.0 / max(_HIGH * 2.0 * window.rows, 1.0)
    height = math.ceil(2.0 * window.rows * per_row) + 1  # of a window, in cells
    columns, rows = int((high_u - low_u) * per_column) + 1, int((high_v - low_v) * per_row) + 1
    inside = np.flatnonzero((u_others >= low_u) & (u_others <= high_u) & (v_others >= low_v) & (v_others <= high_v))
    column, row = (u_others[inside] - low_u) * per_column, (v_others[inside] - low_v) * per_row
    # as many empty rows below those of each kind, so that every window has all of its own
    first_row = (rows + height) * np.arange(int(max(sought.features.kind.max(), others.features.kind.max())) + 2)
    number = (first_row[others.features.kind[inside]] + row.astype(np.int64)) * columns + column.astype(np.int64)
    order = inside[np.argsort(number, kind="stable")]
    start = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=first_row[-1] * columns))])
    first = _cells((u - window.left - low_u) * per_column, columns)
    behind = _cells((u + window.right - low_u) * per_column + 1.0, columns)
    top = _cells((v - window.rows - low_v) * per_row, rows)
    cell = ((first_row[sought.features.kind] + top)[:, None] + np.arange(height)) * columns
    begin, end = start.take(cell + first[:, None]).ravel(), start.take(cell + behind[:, None]).ravel()
    filled = np.flatnonzero(end > begin)
    if len(filled) == 0:
        return nothing
    one, place = _in_turn(filled // height, begin[filled], end[filled])
    other = order.take(place)
    middle, half = 0.5 * (window.right - window.left), 0.5 * (window.right + window.left)
    off = at_others.take(other) - at.take(one)
    off -= np.complex64(middle)
    near = np.flatnonzero((np.abs(off.real) <= half) & (np.abs(off.imag) <= window.rows))
    return one.take(near), other.take(near)


def _in_turn(owner: Indices, begin: Indices, end: Indices) -> tuple[Indices, Indices]:
    """All numbers of the ranges one after another, none of which is empty, and with each the owner of its range.

    Sums of steps, as NumPy repeats numbers more slowly than it adds them up.
    """
    behind = np.cumsum(end - begin)
    owners, numbers = np.zeros(behind[-1], np.int64), np.ones(behind[-1], np.int64)
    owners[0], numbers[0] = owner[0], begin[0]
    owners[behind[:-1]], numbers[behind[:-1]] = np.diff(owner), begin[1:] - end[:-1] + 1
    return np.cumsum(owners), np.cumsum(numbers)


def _places(at: FloatArray) -> NDArray[np.complex64]:
    """u + i v: both in one number that is fetched at once, as there are a hundred thousand pairs to go through."""
    return np.ascontiguousarray(at, dtype=np.float32).view(np.complex64)[:, 0]


def _cells(place: NDArray[np.float32], count: int) -> Indices:
    """Numbers of cells, from 0 to their ``count``, of places in units of a cell."""
    return np.clip(np.floor(place), 0.0, count).astype(np.int64)
