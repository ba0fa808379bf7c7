"""Matching of warped patches: square patches of one image, warped by their local plane, located to sub-pixels.

Inverse-compositional Gauss-Newton on the shift of the patch: gradients are computed on the template, once. Mean and
gain of every patch are normalised, so the exposure may change. Without the warp a patch on the ground is sheared by the
slope of the disparity (baseline over height): 0.09 px of bias and ten times the off-tracking error.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.odometry.image_points import Points
from vehicle.frames import FloatArray

_HALF = 7  # patches of 15 x 15 px
_SIDE = 2 * _HALF + 1
_SPREAD = 0.6 * _HALF  # standard deviation of the Gaussian weights [px]
_ITERATIONS = 5  # at most; most patches converge after three
_DONE = 0.02  # step at convergence; the next would be a fifth of it [px]
_LONGEST_STEP = 1.0  # of an iteration; beyond it the gradients of the template are not valid [px]
_QUIETEST = 1.5  # least assumed noise of an image; residuals of single patches are smaller by chance [grey levels]
_FLATTEST = 1e-3  # least determinant of the structure tensor, for patches without texture [grey levels^4/px4]
_LEAST_CONTRAST = 1e-3  # keeps the gain of a uniform patch finite [grey levels]

Float32Array = NDArray[np.float32]

MARGIN = _HALF + 2  # least distance of a patch's centre from the image's edge [px]


def _grid(half: int) -> tuple[Float32Array, Float32Array]:
    """Offsets u and v of a patch's pixels, row by row."""
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float32)
    return u.ravel(), v.ravel()


_U, _V = _grid(_HALF)
_U_WIDE, _V_WIDE = _grid(_HALF + 1)  # with a border of one pixel for the gradients
_BELL = np.exp(-(_U**2 + _V**2) / (2.0 * _SPREAD**2))
_WEIGHT: Float32Array = _BELL / _BELL.sum()
_NOISE_SHARE = 2.0 * float(np.square(_WEIGHT).sum())  # of the grey-level variance; both images are noisy


class Templates(NamedTuple):
    """Predicted patches with everything that the matching needs of them."""

    gradients: Float32Array  # (2, n, 225) of the grey levels along u and v, weighted, of mean 0 [1/px]
    inverse: Float32Array  # (2, 2, n) of the structure tensor
    offset: Float32Array  # (2, n) product of ``gradients`` with the template itself
    pattern: Float32Array  # (n, 225) weighted grey levels of mean 0
    contrast: Float32Array  # (n,) weighted standard deviation [grey levels]


class PatchMatches(NamedTuple):
    """Positions of matched patches and their quality."""

    points: Points  # (n, 2)
    correlation: Float32Array  # (n,) normalised, at most 1
    variance: Float32Array  # (n, 2) of u and v, from texture and noise of the patch [px2]


def warped_patches(image: Float32Array, centres: Points, warps: FloatArray) -> Float32Array:
    """Grey levels (n, 289) around the centres; ``warps`` (n, 2, 2) map offsets in the other image to offsets here."""
    return sampled(image, *warped_positions(centres, warps))


def warped_positions(centres: Points, warps: FloatArray) -> tuple[Float32Array, Float32Array]:
    """Columns and rows (..., 289) of the pixels of ``warped_patches``."""
    A = warps.astype(np.float32)[..., None]
    u, v = A[..., 0, 0, :] * _U_WIDE, A[..., 1, 0, :] * _U_WIDE
    u += centres[..., :1]
    v += centres[..., 1:]
    u += A[..., 0, 1, :] * _V_WIDE
    v += A[..., 1, 1, :] * _V_WIDE
    return u, v


def sampled(image: Float32Array, u: Float32Array, v: Float32Array) -> Float32Array:
    """Grey levels (n, m) by bilinear interpolation; outside the image those of its edge."""
    if len(u) == 0:
        return np.empty(u.shape, np.float32)
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)


def templates(patches: Float32Array) -> Templates:
    """Templates from warped patches (n, 289)."""
    rows = patches.reshape(-1, _SIDE + 2)
    columns = np.ascontiguousarray(rows[:, 1:-1]).reshape(len(patches), _SIDE * (_SIDE + 2))
    across = _minus(rows[:, 2:], rows[:, :-2]).reshape(columns.shape)[:, _SIDE:-_SIDE]
    down, patch = columns[:, 2 * _SIDE :] - columns[:, : -2 * _SIDE], columns[:, _SIDE:-_SIDE]
    doubled = np.empty((2, *patch.shape), np.float32)  # twice the gradients: differences over two pixels
    for target, difference in zip(doubled, (across, down), strict=True):
        np.subtract(difference, (difference @ _WEIGHT)[:, None], out=target)
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


def match_patches(patches: Templates, image: Float32Array, guess: Points) -> PatchMatches:
    """Locate each patch in the image near its guess (n, 2).

    The correlation is that before a patch's last step, which is shorter than ``_DONE`` once it has converged.
    """
    position, active, left = guess.T.astype(np.float32), np.arange(len(guess)), patches
    correlation = np.zeros(len(guess), np.float32)
    for k in range(_ITERATIONS + 1):
        u, v = position.take(active, axis=1)
        grey = sampled(image, u[:, None] + _U, v[:, None] + _V)
        contrast = _contrast(grey)
        correlation[active] = np.vecdot(left.pattern, grey) / (left.contrast * contrast)
        if k == _ITERATIONS:
            break
        residual = left.contrast / contrast * np.vecdot(left.gradients, grey) - left.offset
        step = (left.inverse * residual).sum(axis=1)
        position[:, active] -= step.clip(-_LONGEST_STEP, _LONGEST_STEP)
        active = active[np.abs(step).max(axis=0) > _DONE]
        if not len(active):
            break
        left = _of(patches, active)
    # the difference of two patches of equal contrast has the variance 2 contrast^2 (1 - correlation), twice that of one
    noise = np.maximum(patches.contrast * np.sqrt(np.maximum(1.0 - correlation, 0.0)), _QUIETEST)
    variance = np.float32(_NOISE_SHARE) * np.square(noise) * patches.inverse[[0, 1], [0, 1]]
    return PatchMatches(np.ascontiguousarray(position.T), correlation, np.ascontiguousarray(variance.T))


def _of(patches: Templates, active: NDArray[np.intp]) -> Templates:
    """Templates of the patches with these indices."""
    return Templates(
        gradients=patches.gradients.take(active, axis=1),
        inverse=patches.inverse.take(active, axis=2),
        offset=patches.offset.take(active, axis=1),
        pattern=patches.pattern.take(active, axis=0),
        contrast=patches.contrast.take(active),
    )


def _minus(one: Float32Array, other: Float32Array) -> Float32Array:
    """Differences (n, m) of row slices; OpenCV is several times as fast as NumPy here."""
    return np.asarray(cv2.subtract(one, other), dtype=np.float32) if len(one) else one


def _contrast(patch: Float32Array) -> Float32Array:
    """Weighted standard deviation (n,) of the grey levels, always positive."""
    variance = np.square(patch) @ _WEIGHT - np.square(patch @ _WEIGHT)
    contrast: Float32Array = np.sqrt(np.maximum(variance, np.float32(_LEAST_CONTRAST**2)))
    return contrast
