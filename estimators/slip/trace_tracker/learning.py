"""Learning of templates from images of traces with known truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.slip.trace_tracker.channels import CHANNELS, channels
from estimators.slip.trace_tracker.ground_patch import BAND, STEP, GroundPatch
from estimators.slip.trace_tracker.matching import straightened
from estimators.slip.trace_tracker.templates import AZIMUTHS, ELEVATIONS, HALF, SLIPS, WIDTH, Profiles, Templates
from sensors.messages import GreyImage
from vehicle.frames import FloatArray

_AZIMUTH_KERNEL: Final = math.radians(12.0)  # width of the kernel over the sun's azimuth
_SLIP_KERNEL: Final = math.radians(1.25)  # the same over slip
_ROWS: Final = round(BAND / STEP)
_SHADED: Final = 0.68  # largest grey level of a band in shadow, relative to the brightest sand


class Lesson(NamedTuple):
    """Profiles of one image, straightened along the true trace."""

    profiles: Profiles  # (n, CHANNELS, WIDTH)
    slips: FloatArray  # (n,) of the front wheel's rut, see ``path_line.with_fronts`` [rad]
    azimuths: FloatArray  # (n,) of the sun relative to the trace, + left [rad]
    elevation: float  # of the sun [rad]
    shaded: NDArray[np.bool_]  # (n,) True: in shadow


def lesson(
    patch: GroundPatch, image: GreyImage, line: FloatArray, front: FloatArray, azimuth: float, elevation: float
) -> Lesson:
    """Training sample from an image with the rear wheel's rut along ``line`` and the front one's along ``front``.

    Both are (n, 2) in R, nearest first [m]. The sun's azimuth is relative to the rover's x axis [rad]. Bands beyond the
    line's ends are left out.
    """
    x, y = patch.rig.wheel
    behind = x - line[:, 0]
    use = (patch.bands > behind[0] + 0.5 * BAND) & (patch.bands < behind[-1] - 0.5 * BAND)
    lateral = np.interp(patch.behind, behind, line[:, 1] - y)
    rectified = patch.rectified(image)
    directions = np.arctan(-np.gradient(lateral, STEP)).reshape(-1, _ROWS).mean(axis=1)
    offset = np.interp(patch.bands, behind, line[:, 1]) - np.interp(patch.bands, x - front[:, 0], front[:, 1])
    return Lesson(
        profiles=straightened(channels(rectified), lateral, margin=0)[use],
        slips=np.arctan2(offset * np.cos(directions), patch.rig.wheelbase)[use],
        azimuths=(azimuth - directions)[use],
        elevation=elevation,
        shaded=_shaded(rectified, lateral)[use],
    )


def learned(lessons: Sequence[Lesson]) -> Templates:
    """Templates from lessons; each is used twice, also mirrored."""
    shape = (AZIMUTHS, len(ELEVATIONS), len(SLIPS))
    sunny, in_sun = np.zeros((*shape, CHANNELS, WIDTH)), np.zeros(shape)
    dark, in_shade = np.zeros((len(SLIPS), CHANNELS, WIDTH)), np.zeros(len(SLIPS))
    for one in lessons:
        level = int(np.argmin(np.abs(ELEVATIONS - one.elevation)))
        for sign in (1, -1):
            profiles = one.profiles[..., ::sign]
            profiles = profiles - profiles.mean(axis=-1, keepdims=True)
            slip = _near(sign * one.slips, SLIPS, _SLIP_KERNEL)
            sun = _near(sign * one.azimuths, np.linspace(0.0, 2.0 * math.pi, AZIMUTHS, endpoint=False), _AZIMUTH_KERNEL)
            weights = sun[:, :, None] * slip[:, None, :] * ~one.shaded[:, None, None]
            sunny[:, level] += np.einsum("nas,ncw->ascw", weights, profiles)
            in_sun[:, level] += weights.sum(axis=0)
            dark += np.einsum("ns,ncw->scw", slip * one.shaded[:, None], profiles)
            in_shade += (slip * one.shaded[:, None]).sum(axis=0)
    return Templates(profiles=_mean(sunny, in_sun), shaded=_mean(dark, in_shade))


def _shaded(rectified: NDArray[np.uint8], lateral: FloatArray) -> NDArray[np.bool_]:
    """Mask (n,) of bands of a trace in shadow."""
    columns = np.clip(
        np.rint(lateral[:, None] / STEP).astype(int) + rectified.shape[1] // 2 + np.arange(-HALF, HALF + 1),
        0,
        rectified.shape[1] - 1,
    )
    levels = np.take_along_axis(rectified, columns, axis=1).reshape(-1, _ROWS * WIDTH)
    dark: NDArray[np.bool_] = np.median(levels, axis=1) < _SHADED * np.percentile(rectified, 95)
    return dark


def _near(values: FloatArray, nodes: FloatArray, width: float) -> FloatArray:
    """Gaussian weights (n, nodes) of angles by their distance from nodes [rad]."""
    off = (values[:, None] - nodes + math.pi) % (2.0 * math.pi) - math.pi
    weights: FloatArray = np.exp(-0.5 * (off / width) ** 2)
    return weights


def _mean(total: FloatArray, weight: FloatArray) -> Profiles:
    return np.asarray(total / np.maximum(weight, 1e-9)[..., None, None], dtype=np.float32)
