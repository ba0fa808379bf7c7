"""Templates from pictures of traces whose truth is known."""

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

_AZIMUTH_KERNEL: Final = math.radians(12.0)  # how far from its own sun and slip a sample tells about a template
_SLIP_KERNEL: Final = math.radians(1.25)
_ROWS: Final = round(BAND / STEP)
_SHADED: Final = 0.68  # grey level against the brightest sand's, below which a band lies in shadow


class Lesson(NamedTuple):
    """Profiles of one picture, straightened along the true trace."""

    profiles: Profiles  # (n, CHANNELS, WIDTH)
    slips: FloatArray  # (n,) by which the front wheel's rut lies aside, see ``path_state.with_front`` [rad]
    azimuths: FloatArray  # (n,) of the sun against the trace, + left [rad]
    elevation: float  # of the sun [rad]
    shaded: NDArray[np.bool_]  # (n,) whether the sun does not reach it


def lesson(
    patch: GroundPatch, image: GreyImage, line: FloatArray, front: FloatArray, azimuth: float, elevation: float
) -> Lesson:
    """What a picture teaches that shows the rear wheel's rut along ``line``, the front one's along ``front``.

    Both are (n, 2) in R, nearest first [m]. The sun's azimuth is that against the rover's x axis [rad]; bands beyond
    the line's ends are left out.
    """
    x, y = patch.rig.wheel
    behind = x - line[:, 0]
    use = (patch.bands > behind[0] + 0.5 * BAND) & (patch.bands < behind[-1] - 0.5 * BAND)
    aside = np.interp(patch.behind, behind, line[:, 1] - y)
    picture = patch.rectified(image)
    directions = np.arctan(-np.gradient(aside, STEP)).reshape(-1, _ROWS).mean(axis=1)
    beside = np.interp(patch.bands, behind, line[:, 1]) - np.interp(patch.bands, x - front[:, 0], front[:, 1])
    return Lesson(
        profiles=straightened(channels(picture), aside, margin=0)[use],
        slips=np.arctan2(beside * np.cos(directions), patch.rig.wheelbase)[use],
        azimuths=(azimuth - directions)[use],
        elevation=elevation,
        shaded=_shaded(picture, aside)[use],
    )


def learned(lessons: Sequence[Lesson]) -> Templates:
    """Templates of lessons; each counts twice, also as seen in a mirror."""
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


def _shaded(picture: NDArray[np.uint8], aside: FloatArray) -> NDArray[np.bool_]:
    """Whether the bands (n,) of a trace lie in shadow."""
    columns = np.clip(
        np.rint(aside[:, None] / STEP).astype(int) + picture.shape[1] // 2 + np.arange(-HALF, HALF + 1),
        0,
        picture.shape[1] - 1,
    )
    levels = np.take_along_axis(picture, columns, axis=1).reshape(-1, _ROWS * WIDTH)
    dark: NDArray[np.bool_] = np.median(levels, axis=1) < _SHADED * np.percentile(picture, 95)
    return dark


def _near(values: FloatArray, nodes: FloatArray, width: float) -> FloatArray:
    """Weights (n, nodes) of angles by their distance from nodes [rad]."""
    off = (values[:, None] - nodes + math.pi) % (2.0 * math.pi) - math.pi
    weights: FloatArray = np.exp(-0.5 * (off / width) ** 2)
    return weights


def _mean(total: FloatArray, weight: FloatArray) -> Profiles:
    return np.asarray(total / np.maximum(weight, 1e-9)[..., None, None], dtype=np.float32)
