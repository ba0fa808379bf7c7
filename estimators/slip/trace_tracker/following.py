"""Measurement update: the trace in an image near its predicted position, and the correction of the path states."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker import histories, path_line
from estimators.slip.trace_tracker.channels import MARKS
from estimators.slip.trace_tracker.ground_patch import STEP, FloatImage
from estimators.slip.trace_tracker.histories import Histories
from estimators.slip.trace_tracker.matching import (
    SEARCH,
    correlation,
    peaks,
    rut_score,
    straightened,
    unit,
    weighed,
    windows,
)
from estimators.slip.trace_tracker.templates import Profiles, at_slips
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_MATCHED: Final = 0.33  # least correlation of a band that shows the trace
_FARTHEST: Final = 3.5  # largest deviation of the trace [standard deviations], plus
_SPARE: Final = 0.004  # [m]
_LOOKS: Final = 2  # iterations; the second is along the corrected line, where templates fit better
# Measurement error of one band in one image, without that of the sand: peaks jump among lug marks and pebbles. In total
# it is about 1.1 mm at a correlation of 0.9, 1.7 at 0.8, 2.6 at 0.7, over 4 at 0.5 (simulated).
_BAND_NOISE: Final = 0.0028  # at a correlation of 0.6 [m]
_BY_CORRELATION: Final = 3  # exponent of its decrease with correlation
# Common error of all bands of one image, from roll, pitch and yaw of the rover on the sand.
_SWAY: Final = 0.0007  # [m]
_TWIST: Final = math.radians(0.05)  # [rad]


class Look(NamedTuple):
    """Matches along the predicted line of the trace in one image."""

    path: Histories  # corrected states
    scores: FloatArray  # (bands,) correlation of the best match
    marks: FloatArray  # (bands,) correlation of the lug marks alone
    accepted: NDArray[np.bool_]  # (bands,) True: the match shows the trace
    sunny: NDArray[np.bool_]  # (bands,) True: more similar to a trace in the sun than in shade
    profiles: Profiles  # (bands, CHANNELS, WIDTH) unit windows at the matches
    slips: FloatArray  # (bands,) of the front wheel's rut, see ``path_line.with_fronts`` [rad]

    @property
    def rut_score(self) -> float:
        """Mean rut score of the whole line."""
        return float(rut_score(self.scores, self.marks).mean())


class Ground(NamedTuple):
    """One rectified image of the ground with the positions of its rows and bands."""

    rig: TraceRig
    image: FloatImage  # (rows, columns, CHANNELS)
    behind: FloatArray  # (rows,) the wheel [m]
    bands: FloatArray  # (bands,) [m]


def matched(ground: Ground, path: Histories, profiles: tuple[Profiles, Profiles]) -> Look:
    """Match the trace in an image; ``profiles`` (slips, ...) are those in the sun and in shade."""
    look = _match(ground, path, path, profiles)
    for _ in range(_LOOKS - 1):
        look = _match(ground, path, look.path, profiles)
    return look


def with_sun(sun: FloatArray, look: Look, known: Profiles) -> FloatArray:
    """Log likelihood of the sun's direction after matches of a trace."""
    use = look.accepted & look.sunny
    return weighed(sun, known, look.profiles[use], look.slips[use]) if use.any() else sun


def _match(ground: Ground, prior: Histories, path: Histories, profiles: tuple[Profiles, Profiles]) -> Look:
    """One step of an iterated Kalman filter from ``prior``, with the measurement taken along ``path``."""
    line, rig = path.together, ground.rig
    expected, gradient = path_line.predicted(line, rig, ground.bands)
    slips = path_line.fronts_at(line, rig, ground.bands)
    cut = windows(straightened(ground.image, path_line.trace(line, rig, ground.behind)))
    std = np.sqrt(np.sum((gradient @ line.covariance) * gradient, axis=1) + _SWAY**2)
    sunny, shaded = (unit(at_slips(templates, slips)) for templates in profiles)
    in_sun, in_shade = correlation(cut, sunny), correlation(cut, shaded)
    off, scores = peaks(np.maximum(in_sun, in_shade), std)
    positions = path_line.trace(line, rig, ground.bands) + off
    accepted = (scores > _MATCHED) & (np.abs(positions - expected) < _FARTHEST * std + _SPARE)
    corrected = path
    if accepted.any():
        noise = _noise(scores[accepted], ground.bands[accepted])
        corrected = histories.with_trace(prior, rig, ground.bands, positions, accepted, noise)
    at = np.rint(off / STEP).astype(int) + SEARCH
    band = np.arange(len(at))
    best, lit = cut[band, at], (in_sun > in_shade)[band, at]
    marks = np.where(lit[:, None], sunny[:, MARKS], shaded[:, MARKS])
    return Look(corrected, scores, np.einsum("bw,bw->b", best[:, MARKS], marks), accepted, lit, best, slips)


def _noise(scores: FloatArray, bands: FloatArray) -> FloatArray:
    """Covariance (n, n) of the measured positions [m2]."""
    own = np.diag((_BAND_NOISE * (0.6 / np.clip(scores, 0.2, 1.0)) ** _BY_CORRELATION) ** 2)
    noise: FloatArray = own + _SWAY**2 + _TWIST**2 * np.outer(bands, bands)
    return noise
