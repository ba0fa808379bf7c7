"""Finding the trace when nothing is known of it but that it starts under the wheel."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from estimators.slip.trace_tracker.channels import CHANNELS, MARKS
from estimators.slip.trace_tracker.ground_patch import BAND, STEP, FloatImage
from estimators.slip.trace_tracker.matching import likeness, unit, windows
from estimators.slip.trace_tracker.templates import HALF, Profiles, at_slips
from vehicle.frames import FloatArray

_ANGLES: Final = np.radians(np.arange(-18.0, 18.1, 2.0))  # of the wheel's travel against the body
_BANDS: Final = 8  # nearest to the wheel
_ASIDE: Final = 3  # how far beside the wheel the trace may start [px]
_HALVES: Final = 2  # of a band: within each a slanting trace is taken for straight
_ROWS: Final = round(BAND / STEP) // _HALVES


class Find(NamedTuple):
    """The best straight trace of a picture."""

    slip: float  # of the wheel's travel against the body [rad]
    score: float  # how much it looks like a rut, see ``likeness``
    marks: float  # correlation of the lug marks alone


def best_straight(image: FloatImage, behind: FloatArray, told: Profiles) -> Find:
    """The straight line through the wheel that looks most like a rut; ``told`` (n, slips, ...) are the ways it may."""
    seen = np.moveaxis(_slanting(image, behind), 2, 1)  # (angles, CHANNELS, shifts, WIDTH)
    ways = unit(at_slips(told, _ANGLES)).transpose(1, 2, 3, 0)  # (angles, CHANNELS, WIDTH, n)
    each = seen @ ways
    marks = each[:, MARKS]
    scores = likeness(each.mean(axis=1), marks)
    best = np.unravel_index(scores.argmax(), scores.shape)
    return Find(float(_ANGLES[best[0]]), float(scores[best]), float(marks[best]))


def _slanting(image: FloatImage, behind: FloatArray) -> Profiles:
    """Mean over the bands of unit windows (angles, shifts, CHANNELS, WIDTH) along straight lines from the wheel."""
    rows = _BANDS * _HALVES * _ROWS
    halves = image[:rows].reshape(-1, _ROWS, *image.shape[1:]).mean(axis=1)
    at = behind[:rows].reshape(-1, _ROWS).mean(axis=1)
    reach = np.arange(-HALF - _ASIDE, HALF + _ASIDE + 1)
    middle = np.rint(-np.tan(_ANGLES)[:, None] * at / STEP).astype(int) + image.shape[1] // 2
    columns = np.clip(middle[..., None] + reach, 0, image.shape[1] - 1)
    slanting = halves[np.arange(len(at))[None, :, None], columns]  # (angles, halves, reach, CHANNELS)
    profiles = slanting.reshape(len(_ANGLES), -1, _HALVES, len(reach), CHANNELS).mean(axis=2).transpose(0, 1, 3, 2)
    mean: Profiles = windows(profiles).mean(axis=1)
    return mean
