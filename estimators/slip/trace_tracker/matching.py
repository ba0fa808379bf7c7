"""Lateral matching of ground profiles with rut templates by normalised correlation, and what it tells of the sun."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from estimators.slip.trace_tracker.channels import CHANNELS
from estimators.slip.trace_tracker.ground_patch import BAND, STEP, FloatImage
from estimators.slip.trace_tracker.templates import ELEVATIONS, HALF, WIDTH, Profiles, Templates, at_slips
from vehicle.frames import FloatArray

_COURSES: Final = 24  # number of azimuths in the world that are compared
_WORTH: Final = 4.0  # log likelihood per unit of correlation, by band of one image
_FORGETTING: Final = 0.99  # per image: the sun moves, and clouds appear
_NEGLIGIBLE: Final = 8.0  # difference of log likelihood to the best that is ignored
SEARCH: Final = round(0.034 / STEP)  # largest lateral distance of the trace from its prediction [px]
_ROWS: Final = round(BAND / STEP)
_FLAT: Final = 1e-6  # norm of a profile without any marks


def straightened(image: FloatImage, lateral: FloatArray, margin: int = SEARCH) -> Profiles:
    """Profiles (bands, CHANNELS, WIDTH + 2 margin) along a line at ``lateral`` (rows,) from the middle [m]."""
    rows, columns = image.shape[:2]
    reach = np.arange(-HALF - margin, HALF + margin + 1)
    u = (lateral[:, None] / STEP + columns // 2 + reach).astype(np.float32)
    v = np.repeat(np.arange(rows, dtype=np.float32)[:, None], len(reach), axis=1)
    straight = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profiles: Profiles = straight.reshape(-1, _ROWS, len(reach), CHANNELS).mean(axis=1).transpose(0, 2, 1)
    return profiles


def windows(profiles: Profiles) -> Profiles:
    """All windows of a template's width (..., shifts, CHANNELS, WIDTH), each of mean 0 and norm 1."""
    sums, squares = (_sums(values)[..., None] for values in (profiles, np.square(profiles)))
    lengths = np.sqrt(np.maximum(squares - sums**2 / WIDTH, 0.0)) + _FLAT
    parts = (sums / WIDTH).astype(np.float32), (1.0 / lengths).astype(np.float32)
    mean, scale = (np.swapaxes(part, -2, -3) for part in parts)
    cut = np.swapaxes(sliding_window_view(profiles, WIDTH, axis=-1), -2, -3)
    free = np.subtract(cut, mean, order="C")
    free *= scale
    return free


def unit(profiles: Profiles) -> Profiles:
    """Profiles normalised to mean 0 and norm 1."""
    ones = np.full(profiles.shape[-1], 1.0 / profiles.shape[-1], dtype=np.float32)
    free = profiles - (profiles @ ones)[..., None]
    free /= np.sqrt(np.einsum("...w,...w->...", free, free))[..., None] + np.float32(_FLAT)
    return free


def _sums(values: Profiles) -> FloatArray:
    """Sums over all windows of a template's width (..., shifts), by cumulative sums."""
    running = np.zeros((*values.shape[:-1], values.shape[-1] + 1))
    np.cumsum(values, axis=-1, out=running[..., 1:])
    sums: FloatArray = running[..., WIDTH:] - running[..., :-WIDTH]
    return sums


def correlation(cut: Profiles, templates: Profiles) -> FloatArray:
    """Mean over the channels (bands, shifts) of unit windows (bands, shifts, ...) and unit templates (bands, ...)."""
    bands, shifts = cut.shape[:2]
    flat = cut.reshape(bands, shifts, -1) @ templates.reshape(bands, -1, 1)
    return np.asarray(flat[..., 0] / CHANNELS, dtype=np.float64)


def rut_score(scores: ArrayLike, marks: ArrayLike) -> FloatArray:
    """Score of a rut: mean correlation of all channels, with double weight of the lug marks.

    Shadows have edges like walls and are as dark as ruts, but only wheels leave lug marks.
    """
    more: FloatArray = (CHANNELS * np.asarray(scores) + np.asarray(marks)) / (CHANNELS + 1)
    return more


def peaks(scores: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Offset (bands,) [m] of the best match in scores (bands, shifts), and its score.

    Offsets are penalised by their distance in units of ``std`` (bands,) [m].
    """
    shifts = (np.arange(scores.shape[1]) - scores.shape[1] // 2) * STEP
    penalty = 0.03 * (shifts / np.maximum(std, 0.004)[:, None]) ** 2
    k = np.clip((scores - penalty).argmax(axis=1), 1, len(shifts) - 2)
    band = np.arange(len(scores))
    before, at, after = scores[band, k - 1], scores[band, k], scores[band, k + 1]
    bend = before - 2.0 * at + after
    finer = np.where(bend < -1e-9, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0)
    return shifts[k] + STEP * np.clip(finer, -1.0, 1.0), at


def unknown_sun() -> FloatArray:
    """Uniform log likelihood (courses, elevations)."""
    return np.zeros((_COURSES, len(ELEVATIONS)))


def lit(templates: Templates, direction: float) -> Profiles:
    """Profiles (courses, elevations, slips, ...) of a trace in a world direction [rad], for all suns."""
    azimuths = np.asarray(2.0 * math.pi / _COURSES * np.arange(_COURSES) - direction, dtype=np.float64)
    return templates.under(azimuths)


def probable(sun: FloatArray) -> FloatArray:
    """Mask (courses, elevations) of suns that are not improbable."""
    worth: FloatArray = sun > sun.max() - _NEGLIGIBLE
    return worth


def expected(profiles: Profiles, sun: FloatArray) -> Profiles:
    """Expected profiles (slips, ...), weighted with the probability of each sun."""
    share = np.exp(sun - sun.max())
    mixed: Profiles = np.tensordot((share / share.sum()).astype(np.float32), profiles, axes=2)
    return mixed


def weighed(sun: FloatArray, profiles: Profiles, observed: Profiles, slips: FloatArray) -> FloatArray:
    """Log likelihood after observed rut profiles (n, CHANNELS, WIDTH) at slips (n,)."""
    predicted = unit(at_slips(profiles, slips))
    scores = np.einsum("asncw,ncw->as", predicted, observed, optimize=True) / CHANNELS
    belief: FloatArray = _FORGETTING * sun + _WORTH * scores
    belief -= belief.max()
    return belief
