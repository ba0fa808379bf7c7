"""For features of one image the most similar ones of another within a window, by sums of absolute differences."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.viso2_features import Features
from vehicle.frames import FloatArray

_BAND = 16  # features are sorted into bands of rows so high [px]
_WIDTH = 1 << 14  # more columns than any image has, so that the sort keys of bands do not mix [px]

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

    In every band of rows they are a range of columns.
    """
    lowest = float(np.min(sought.at[:, 1], initial=0.0)) - window.rows
    highest = float(np.max(sought.at[:, 1], initial=0.0)) + window.rows
    bands = int((highest - lowest) // _BAND) + 2
    inside = np.flatnonzero((others.at[:, 1] >= lowest) & (others.at[:, 1] <= highest))
    keys = _keys(others.features.kind[inside] * bands + (others.at[inside, 1] - lowest) // _BAND, others.at[inside, 0])
    order = np.argsort(keys, kind="stable")
    kind, u, v = sought.features.kind * bands, sought.at[:, 0], sought.at[:, 1] - lowest
    steps = np.arange(int(2.0 * window.rows // _BAND) + 2)
    band = kind[:, None] + np.minimum(((v - window.rows) // _BAND)[:, None] + steps, bands - 1)
    start = np.searchsorted(keys[order], _keys(band, (u - window.left)[:, None]).ravel())
    count = np.searchsorted(keys[order], _keys(band, (u + window.right)[:, None]).ravel(), side="right") - start
    one = np.repeat(np.repeat(np.arange(len(u)), len(steps)), count)
    place = np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count)
    other = inside[order[np.repeat(start, count) + place]]
    near = np.abs(sought.at[one, 1] - others.at[other, 1]) <= window.rows
    return one[near], other[near]


def _keys(band: FloatArray | Indices, u: FloatArray) -> FloatArray:
    """Sort keys (n,): by band, then by column."""
    keys: FloatArray = band.astype(np.float64) * _WIDTH + np.clip(u + 0.25 * _WIDTH, 0.0, _WIDTH - 1.0)
    return keys
