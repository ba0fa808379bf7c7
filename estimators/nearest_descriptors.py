"""For features of one image the most similar ones of another within a window, by sums of absolute differences."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.viso2_features import Features
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
    misfit = cv2.reduce(cv2.absdiff(ours, theirs), 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel().astype(np.int64)
    first = np.flatnonzero(np.diff(one, prepend=-1))
    least = np.minimum.reduceat(misfit * len(others.at) + other, first)  # of equal ones the first in the list
    best[one[first]] = least % len(others.at)
    return best


def _candidates(sought: Placed, others: Placed, window: Window) -> tuple[Indices, Indices]:
    """All pairs of one kind with the other in the window of the one, sorted by the one.

    The others are sorted into cells of a grid; in every row of cells those to be looked at follow one another.
    """
    nothing = np.zeros(0, np.int64), np.zeros(0, np.int64)
    if len(sought.at) == 0 or len(others.at) == 0:
        return nothing
    u, v = _columns(sought.at)
    u_others, v_others = _columns(others.at)
    low_u, high_u = max(u.min() - window.left, u_others.min()), min(u.max() + window.right, u_others.max())
    low_v, high_v = max(v.min() - window.rows, v_others.min()), min(v.max() + window.rows, v_others.max())
    if low_u > high_u or low_v > high_v:
        return nothing
    per_column = 1.0 / max(_WIDE * (window.left + window.right), 1.0)
    per_row = 1.0 / max(_HIGH * 2.0 * window.rows, 1.0)
    columns, rows = int((high_u - low_u) * per_column) + 1, int((high_v - low_v) * per_row) + 1
    inside = np.flatnonzero((u_others >= low_u) & (u_others <= high_u) & (v_others >= low_v) & (v_others <= high_v))
    column, row = (u_others[inside] - low_u) * per_column, (v_others[inside] - low_v) * per_row
    number = (others.features.kind[inside] * rows + row.astype(np.int64)) * columns + column.astype(np.int64)
    order = inside[np.argsort(number, kind="stable")]
    kinds = int(max(sought.features.kind.max(), others.features.kind.max())) + 1
    start = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=kinds * rows * columns))])
    first = _cells((u - window.left - low_u) * per_column, columns)
    behind = _cells((u + window.right - low_u) * per_column + 1.0, columns)
    top = _cells((v - window.rows - low_v) * per_row, rows)
    below = _cells((v + window.rows - low_v) * per_row + 1.0, rows)
    row_of = sought.features.kind * rows + top
    ends = []
    for step in range(int(2.0 * window.rows * per_row) + 2):
        base = np.where(top + step < below, row_of + step, 0) * columns
        ends.append([start[base + first], np.where(top + step < below, start[base + behind], start[base + first])])
    begin, end = np.array(ends).transpose(1, 2, 0).reshape(2, -1)
    count = end - begin
    one = np.repeat(np.arange(len(u)), count.reshape(len(u), -1).sum(axis=1))
    other = order[np.arange(len(one)) + np.repeat(begin - (np.cumsum(count) - count), count)]
    off_u, off_v = np.take(u_others, other) - np.take(u, one), np.take(v_others, other) - np.take(v, one)
    near = np.flatnonzero((off_u >= -window.left) & (off_u <= window.right) & (np.abs(off_v) <= window.rows))
    return one[near], other[near]


def _columns(at: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows, each in one piece and half the size: there are a hundred thousand pairs to go through."""
    return at[:, 0].astype(np.float32), at[:, 1].astype(np.float32)


def _cells(place: NDArray[np.float32], count: int) -> Indices:
    """Numbers of cells, from 0 to their ``count``, of places in units of a cell."""
    return np.clip(np.floor(place), 0.0, count).astype(np.int64)
