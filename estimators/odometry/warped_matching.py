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

from estimators.odometry.corners import Points
from vehicle.frames import FloatArray

_HALF = 7  # patches of 15 x 15 px
_SIDE = 2 * _HALF + 1
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

    gradients: Float32Array  # (2, n, 225) of the grey levels along u and v, weighted, of mean 0 [1/px]
    inverse: Float32Array  # (2, 2, n) of the structure tensor
    offset: Float32Array  # (2, n) what ``gradients`` make of the template itself
    pattern: Float32Array  # (n, 225) weighted grey levels of mean 0
    contrast: Float32Array  # (n,) weighted standard deviation [grey levels]


class Found(NamedTuple):
    """Where patches were found, and how well."""

    points: Points  # (n, 2)
    likeness: Float32Array  # (n,) normalised correlation; 1 at best
    variance: Float32Array  # (n, 2) of u and v, from texture and noise of the patch [px2]


def warped_patches(image: Float32Array, centres: Points, warps: FloatArray) -> Float32Array:
    """Grey levels (n, 289) around the centres; ``warps`` (n, 2, 2) take offsets in the other image to offsets here."""
    return sampled(image, *warped_places(centres, warps))


def warped_places(centres: Points, warps: FloatArray) -> tuple[Float32Array, Float32Array]:
    """Columns and rows (..., 289) of the pixels of warped patches, of ``warped_patches``' arguments (..., 2)."""
    A = warps.astype(np.float32)[..., None]
    u, v = A[..., 0, 0, :] * _U_WIDE, A[..., 1, 0, :] * _U_WIDE
    u += centres[..., :1]
    v += centres[..., 1:]
    u += A[..., 0, 1, :] * _V_WIDE
    v += A[..., 1, 1, :] * _V_WIDE
    return u, v


def sampled(image: Float32Array, u: Float32Array, v: Float32Array) -> Float32Array:
    """Grey levels (n, m) at positions between pixels; beyond the edge those of the edge."""
    if len(u) == 0:
        return np.empty(u.shape, np.float32)
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)


def templates(patches: Float32Array) -> Templates:
    """Templates from warped patches (n, 289)."""
    rows = patches.reshape(-1, _SIDE + 2)
    columns = np.ascontiguousarray(rows[:, 1:-1]).reshape(len(patches), _SIDE * (_SIDE + 2))
    across = _minus(rows[:, 2:], rows[:, :-2]).reshape(columns.shape)[:, _SIDE:-_SIDE]
    down, patch = columns[:, 2 * _SIDE :] - columns[:, : -2 * _SIDE], columns[:, _SIDE:-_SIDE]
    doubled = np.empty((2, *patch.shape), np.float32)  # gradients: differences over two pixels
    for of_doubled, difference in zip(doubled, (across, down), strict=True):
        np.subtract(difference, (difference @ _WEIGHT)[:, None], out=of_doubled)
    gradients = doubled * (np.float32(0.5) * _WEIGHT)
    a, b, c = (np.float32(0.5) * np.vecdot(gradients[i], doubled[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    deviation = patch - (patch @ _WEIGHT)[:, None]
    pattern = deviation * _WEIGHT
    return Templates(
        gradients=gradients,
        inverse=np.array([[c, -b], [-b, a]]) / np.maximum(a * c - b * b, np.float32(_FLATTEST)),
        offset=np.vecdot(gradients, patch),
        pattern=pattern,
        contrast=np.sqrt(np.maximum(np.vecdot(pattern, deviation), np.float32(_LEAST_CONTRAST**2))),
    )


def find(sought: Templates, image: Float32Array, guess: Points) -> Found:
    """The patches in the image, each near its guess (n, 2)."""
    at, active = guess.T.astype(np.float32), np.arange(len(guess))
    for _ in range(_ITERATIONS):
        u, v = at.take(active, axis=1)
        seen = sampled(image, u[:, None] + _U, v[:, None] + _V)
        gain = sought.contrast.take(active) / _contrast(seen)
        misfit = gain * np.vecdot(sought.gradients.take(active, axis=1), seen) - sought.offset.take(active, axis=1)
        step = (sought.inverse.take(active, axis=2) * misfit).sum(axis=1)
        at[:, active] -= step.clip(-_LONGEST_STEP, _LONGEST_STEP)
        active = active[np.abs(step).max(axis=0) > _DONE]
    u, v = at
    seen = sampled(image, u[:, None] + _U, v[:, None] + _V)
    likeness = np.vecdot(sought.pattern, seen) / (sought.contrast * _contrast(seen))
    # the difference of two patches of equal contrast has the variance 2 contrast^2 (1 - likeness), twice that of one
    noise = np.maximum(sought.contrast * np.sqrt(np.maximum(1.0 - likeness, 0.0)), _QUIETEST)
    variance = np.float32(_NOISE_SHARE) * np.square(noise) * sought.inverse[[0, 1], [0, 1]]
    return Found(np.ascontiguousarray(at.T), likeness, np.ascontiguousarray(variance.T))


def _minus(one: Float32Array, other: Float32Array) -> Float32Array:
    """Differences (n, m) of parts of rows, which OpenCV goes through several times as fast as NumPy."""
    return np.asarray(cv2.subtract(one, other), dtype=np.float32) if len(one) else one


def _contrast(patch: Float32Array) -> Float32Array:
    """Weighted standard deviation (n,) of the grey levels, never quite 0."""
    variance = np.square(patch) @ _WEIGHT - np.square(patch @ _WEIGHT)
    contrast: Float32Array = np.sqrt(np.maximum(variance, np.float32(_LEAST_CONTRAST**2)))
    return contrast
