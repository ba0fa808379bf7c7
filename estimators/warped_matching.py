"""Warped matching: square patches of one image, bent as a plane seen from elsewhere, found in another to sub-pixels.

Inverse-compositional Gauss-Newton on the shift of the patch: gradients are taken on the template, once. Mean and gain
of every patch are normalised away, so exposure may change. A patch that is only shifted, not warped, is sheared on the
ground by the disparity's slope (baseline over height): 0.09 px of bias and ten times the off-tracking error.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.features import Points
from vehicle.frames import FloatArray

_HALF = 7  # patches of 15 x 15 px
_SPREAD = 0.6 * _HALF  # standard deviation of the Gaussian weights [px]
_ITERATIONS = 5  # at most; most patches are done after three
_DONE = 0.02  # a step shorter than this is the last: the next would be a fifth of it [px]
_LONGEST_STEP = 1.0  # an iteration may go; beyond, the gradients of the template say nothing [px]
_QUIETEST = 1.5  # least noise of an image: residuals of single patches come out smaller by chance [grey levels]
_FLATTEST = 1e-3  # least determinant of the structure tensor, where a patch has no texture at all [grey levels^4/px4]
_LEAST_CONTRAST = 1e-3  # keeps the gain of a plain patch finite [grey levels]

Float32Array = NDArray[np.float32]

MARGIN = _HALF + 2  # patches must lie so far inside an image [px]


def _grid(half: int) -> tuple[Float32Array, Float32Array]:
    """Offsets u and v of a patch's pixels, row by row."""
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float32)
    return u.ravel(), v.ravel()


_U, _V = _grid(_HALF)
_U_WIDE, _V_WIDE = _grid(_HALF + 1)  # one more all around, for the gradients
_BELL = np.exp(-(_U**2 + _V**2) / (2.0 * _SPREAD**2))
_WEIGHT: Float32Array = _BELL / _BELL.sum()
_NOISE_SHARE = 2.0 * float(np.square(_WEIGHT).sum())  # of the grey levels' variance; template and image are both noisy


class Templates(NamedTuple):
    """Patches as they should look in another image, ready to be looked for there."""

    slopes: Float32Array  # (n, 2, 225) shift per grey level: gradients solved by the structure tensor [px]
    offset: Float32Array  # (n, 2) what ``slopes`` make of the template itself [px]
    pattern: Float32Array  # (n, 225) weighted grey levels of mean 0 and spread 1
    contrast: Float32Array  # (n,) weighted standard deviation [grey levels]
    unit_variance: Float32Array  # (n, 2) variance of the shift for one grey level of noise [px2]


class Found(NamedTuple):
    """Where patches were found, and how well."""

    points: Points  # (n, 2)
    likeness: Float32Array  # (n,) normalised correlation; 1 at best
    variance: Float32Array  # (n, 2) of u and v, from texture and noise of the patch [px2]


def warped_patches(image: Float32Array, centres: Points, warps: FloatArray) -> Float32Array:
    """Grey levels (n, 289) around the centres; ``warps`` (n, 2, 2) take offsets in the other image to offsets here."""
    A = warps.astype(np.float32)
    u = centres[:, :1] + A[:, 0, :1] * _U_WIDE + A[:, 0, 1:] * _V_WIDE
    v = centres[:, 1:] + A[:, 1, :1] * _U_WIDE + A[:, 1, 1:] * _V_WIDE
    return _sampled(image, u, v)


def templates(patches: Float32Array) -> Templates:
    """Templates from warped patches (n, 289)."""
    wide = patches.reshape(len(patches), 2 * _HALF + 3, 2 * _HALF + 3)
    patch = wide[:, 1:-1, 1:-1].reshape(len(wide), len(_WEIGHT))
    gradient = np.empty((len(wide), 2, patch.shape[1]), np.float32)
    gradient[:, 0] = (0.5 * (wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2])).reshape(patch.shape)
    gradient[:, 1] = (0.5 * (wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1])).reshape(patch.shape)
    gradient -= (gradient @ _WEIGHT)[..., None]
    weighted = gradient * _WEIGHT
    tensor = np.einsum("nki,nli->nkl", weighted, gradient)
    a, b, c = tensor[:, 0, 0], tensor[:, 0, 1], tensor[:, 1, 1]
    inverse = np.stack([c, -b, -b, a], axis=1).reshape(-1, 2, 2) / np.maximum(a * c - b * b, _FLATTEST)[:, None, None]
    slopes = inverse @ weighted
    contrast = _contrast(patch)
    return Templates(
        slopes=slopes,
        offset=np.einsum("nki,ni->nk", slopes, patch),
        pattern=(patch - (patch @ _WEIGHT)[:, None]) * (_WEIGHT / contrast[:, None]),
        contrast=contrast,
        unit_variance=np.float32(_NOISE_SHARE) * np.stack([inverse[:, 0, 0], inverse[:, 1, 1]], axis=1),
    )


def find(sought: Templates, image: Float32Array, guess: Points) -> Found:
    """The patches in the image, each near its guess (n, 2)."""
    points, active = guess.astype(np.float32), np.arange(len(guess))
    for _ in range(_ITERATIONS):
        seen = _sampled(image, points[active, :1] + _U, points[active, 1:] + _V)
        gain = sought.contrast[active] / _contrast(seen)
        step = gain[:, None] * np.einsum("nki,ni->nk", sought.slopes[active], seen) - sought.offset[active]
        points[active] -= np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        active = active[np.abs(step).max(axis=1) > _DONE]
    seen = _sampled(image, points[:, :1] + _U, points[:, 1:] + _V)
    likeness = np.einsum("ni,ni->n", sought.pattern, seen) / _contrast(seen)
    # the difference of two patches of equal contrast has the variance 2 contrast^2 (1 - likeness), twice that of one
    noise = np.maximum(sought.contrast * np.sqrt(np.maximum(1.0 - likeness, 0.0)), _QUIETEST)
    return Found(points, likeness, np.square(noise)[:, None] * sought.unit_variance)


def _sampled(image: Float32Array, u: Float32Array, v: Float32Array) -> Float32Array:
    """Grey levels (n, m) at positions between pixels; beyond the edge those of the edge."""
    if len(u) == 0:
        return np.empty(u.shape, np.float32)
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)


def _contrast(patch: Float32Array) -> Float32Array:
    """Weighted standard deviation (n,) of the grey levels, never quite 0."""
    variance = np.square(patch) @ _WEIGHT - np.square(patch @ _WEIGHT)
    contrast: Float32Array = np.sqrt(np.maximum(variance, np.float32(_LEAST_CONTRAST**2)))
    return contrast
