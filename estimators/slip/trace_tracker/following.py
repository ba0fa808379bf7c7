"""The trace in a picture, looked for where its history says that it lies, and the history corrected by it."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker import histories, path_line
from estimators.slip.trace_tracker.channels import MARKS
from estimators.slip.trace_tracker.ground_patch import STEP, FloatImage
from estimators.slip.trace_tracker.histories import Histories
from estimators.slip.trace_tracker.matching import SEARCH, correlation, likeness, peaks, straightened, unit, windows
from estimators.slip.trace_tracker.sun_belief import weighed
from estimators.slip.trace_tracker.templates import Profiles, at_slips
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_MATCHED: Final = 0.33  # correlation of a band that is taken for the trace
_FARTHEST: Final = 3.5  # standard deviations that the trace may lie off, and
_SPARE: Final = 0.004  # [m]
_LOOKS: Final = 2  # a second time along the corrected line, where templates fit better
# Of one band in one picture, beside what the sand itself is off by: peaks jump among lug marks and pebbles. With
# the sand's part it is some 1.1 mm where the correlation is 0.9, 1.7 at 0.8, 2.6 at 0.7, over 4 at 0.5 (simulated).
_BAND_NOISE: Final = 0.0028  # at a correlation of 0.6 [m]
_BY_CORRELATION: Final = 3  # power by which it falls with correlation
# What all bands of one picture share, as roll, pitch and yaw of the rover on its springs of sand move the camera.
_SWAY: Final = 0.0007  # [m]
_TWIST: Final = math.radians(0.05)  # [rad]


class Look(NamedTuple):
    """What one picture showed along the line where the trace was expected."""

    path: Histories  # corrected
    scores: FloatArray  # (bands,) correlation of the best match
    marks: FloatArray  # (bands,) that of the lug marks alone
    seen: NDArray[np.bool_]  # (bands,) whether that was taken for the trace
    sunny: NDArray[np.bool_]  # (bands,) whether it looks like a trace in the sun rather than in shade
    profiles: Profiles  # (bands, CHANNELS, WIDTH) unit windows there
    slips: FloatArray  # (bands,) by which the front wheel's rut lies aside, see ``path_line.with_fronts`` [rad]

    @property
    def likeness(self) -> float:
        """Of the whole line to a rut."""
        return float(likeness(self.scores, self.marks).mean())


class Ground(NamedTuple):
    """One picture of the ground and where its rows and bands lie."""

    rig: TraceRig
    image: FloatImage  # (rows, columns, CHANNELS)
    behind: FloatArray  # (rows,) the wheel [m]
    bands: FloatArray  # (bands,) [m]


def looked(ground: Ground, path: Histories, told: tuple[Profiles, Profiles]) -> Look:
    """The trace as this picture has it; ``told`` are the profiles (slips, ...) in the sun and in shade."""
    look = _look(ground, path, path, told)
    for _ in range(_LOOKS - 1):
        look = _look(ground, path, look.path, told)
    return look


def with_sun(sun: FloatArray, look: Look, known: Profiles) -> FloatArray:
    """The belief after a look at a trace."""
    use = look.seen & look.sunny
    return weighed(sun, known, look.profiles[use], look.slips[use]) if use.any() else sun


def _look(ground: Ground, prior: Histories, path: Histories, told: tuple[Profiles, Profiles]) -> Look:
    """One step of an iterated Kalman filter from ``prior``, with its measurement taken along ``path``."""
    line, rig = path.together, ground.rig
    expected, gradient = path_line.seen(line, rig, ground.bands)
    slips = path_line.fronts_at(line, rig, ground.bands)
    cut = windows(straightened(ground.image, path_line.trace(line, rig, ground.behind)))
    std = np.sqrt(np.sum((gradient @ line.covariance) * gradient, axis=1) + _SWAY**2)
    sunny, shaded = (unit(at_slips(profiles, slips)) for profiles in told)
    in_sun, in_shade = correlation(cut, sunny), correlation(cut, shaded)
    off, scores = peaks(np.maximum(in_sun, in_shade), std)
    places = path_line.trace(line, rig, ground.bands) + off
    seen = (scores > _MATCHED) & (np.abs(places - expected) < _FARTHEST * std + _SPARE)
    corrected = path
    if seen.any():
        noise = _noise(scores[seen], ground.bands[seen])
        corrected = histories.with_trace(prior, rig, ground.bands, places, seen, noise)
    at = np.rint(off / STEP).astype(int) + SEARCH
    band = np.arange(len(at))
    best, lit = cut[band, at], (in_sun > in_shade)[band, at]
    marks = np.where(lit[:, None], sunny[:, MARKS], shaded[:, MARKS])
    return Look(corrected, scores, np.einsum("bw,bw->b", best[:, MARKS], marks), seen, lit, best, slips)


def _noise(scores: FloatArray, bands: FloatArray) -> FloatArray:
    """Covariance (n, n) of the places seen [m2]."""
    own = np.diag((_BAND_NOISE * (0.6 / np.clip(scores, 0.2, 1.0)) ** _BY_CORRELATION) ** 2)
    noise: FloatArray = own + _SWAY**2 + _TWIST**2 * np.outer(bands, bands)
    return noise
