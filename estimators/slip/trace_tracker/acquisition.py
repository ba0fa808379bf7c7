"""Acquisition: search for a trace that starts under the wheel, without prior knowledge."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from estimators.slip.trace_tracker.channels import CHANNELS, MARKS
from estimators.slip.trace_tracker.ground_patch import BAND, STEP, FloatImage
from estimators.slip.trace_tracker.matching import rut_score, unit, windows
from estimators.slip.trace_tracker.templates import HALF, Profiles, at_slips
from vehicle.frames import FloatArray

_ANGLES: Final = np.radians(np.arange(-18.0, 18.1, 2.0))  # of the wheel's travel relative to the body
_BANDS: Final = 8  # nearest to the wheel, used for the search
_LATERAL: Final = 3  # largest lateral offset of the trace at the wheel [px]
_HALVES: Final = 2  # parts of a band: in each a slanting trace counts as straight
_ROWS: Final = round(BAND / STEP) // _HALVES


class Find(NamedTuple):
    """Best straight trace in an image."""

    slip: float  # of the wheel's travel relative to the body [rad]
    score: float  # see ``matching.rut_score``
    marks: float  # correlation of the lug marks alone


def best_straight(image: FloatImage, behind: FloatArray, profiles: Profiles) -> Find:
    """Straight line through the wheel with the best rut score, over the template ``profiles`` (n, slips, ...)."""
    windows_at = np.moveaxis(_slanting(image, behind), 2, 1)  # (angles, CHANNELS, shifts, WIDTH)
    templates = unit(at_slips(profiles, _ANGLES)).transpose(1, 2, 3, 0)  # (angles, CHANNELS, WIDTH, n)
    each = windows_at @ templates
    marks = each[:, MARKS]
    scores = rut_score(each.mean(axis=1), marks)
    best = np.unravel_index(scores.argmax(), scores.shape)
    return Find(float(_ANGLES[best[0]]), float(scores[best]), float(marks[best]))


def _slanting(image: FloatImage, behind: FloatArray) -> Profiles:
    """Mean unit windows (angles, shifts, CHANNELS, WIDTH) of the bands along straight lines from the wheel."""
    rows = _BANDS * _HALVES * _ROWS
    halves = image[:rows].reshape(-1, _ROWS, *image.shape[1:]).mean(axis=1)
    at = behind[:rows].reshape(-1, _ROWS).mean(axis=1)
    reach = np.arange(-HALF - _LATERAL, HALF + _LATERAL + 1)
    middle = np.rint(-np.tan(_ANGLES)[:, None] * at / STEP).astype(int) + image.shape[1] // 2
    columns = np.clip(middle[..., None] + reach, 0, image.shape[1] - 1)
    slanting = halves[np.arange(len(at))[None, :, None], columns]  # (angles, halves, reach, CHANNELS)
    profiles = slanting.reshape(len(_ANGLES), -1, _HALVES, len(reach), CHANNELS).mean(axis=2).transpose(0, 1, 3, 2)
    mean: Profiles = windows(profiles).mean(axis=1)
    return mean
