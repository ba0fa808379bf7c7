"""Matching of warped patches: square patches of images, warped by their local plane, located to sub-pixels.

Inverse-compositional Gauss-Newton on the shift of the patch: gradients are computed on the template, once. Mean and
gain of every patch are normalised, so the exposure may change. Without the warp a patch on the ground is sheared by the
slope of the disparity (baseline over height): 0.09 px of bias and ten times the off-tracking error.

It is compiled C (``patches.c``); without a C compiler OpenCV and NumPy do the same in several times the time.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.odometry.image_points import Points
from sensors.messages import GreyImage
from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray

_HALF = 7  # patches of 15 x 15 px
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
_BELL = np.exp(-(_U**2 + _V**2) / (2.0 * _SPREAD**2))
_WEIGHT: Float32Array = _BELL / _BELL.sum()
_NOISE_SHARE = 2.0 * float(np.square(_WEIGHT).sum())  # of the grey-level variance; both images are noisy
_ROWS = np.pad(_WEIGHT.reshape(2 * _HALF + 1, -1), ((0, 0), (0, 1)))  # of the weights, with a column of zeros
_NUMBERS = (
    *(f"HALF={_HALF}", f"ITERATIONS={_ITERATIONS}", f"DONE={_DONE}f", f"LONGEST_STEP={_LONGEST_STEP}f"),
    *(f"QUIETEST={_QUIETEST}f", f"FLATTEST={_FLATTEST}f", f"LEAST_CONTRAST={_LEAST_CONTRAST}f"),
    f"NOISE_SHARE={_NOISE_SHARE}f",
)


class PatchMatches(NamedTuple):
    """Positions of matched patches and their quality."""

    points: Points  # (n, 2)
    correlation: Float32Array  # (n,) normalised, at most 1; before a patch's last step, which is short by then
    variance: Float32Array  # (n, 2) of u and v, from texture and noise of the patch [px2]


def match_patches(
    sources: Sequence[tuple[GreyImage, int]], centres: Points, warps: FloatArray, target: GreyImage, guess: Points
) -> PatchMatches:
    """Locate patches in the target image, each near its guess (n, 2): 5 px away at most.

    Args:
        sources: images of the size of the target, each with its number of patches, in the order of the patches.
        centres: of the patches in their images (n, 2) [px].
        warps: (n, 2, 2) map offsets in the target to offsets in the patch's image.
        target: image in which the patches are located.
        guess: (n, 2) [px].
    """
    n, compiled = len(guess), kernel("estimators.odometry", "patches.c", "match", _NUMBERS)
    if n == 0:
        return PatchMatches(guess, np.empty(0, np.float32), np.empty((0, 2), np.float32))
    if compiled is None:
        ends = np.cumsum([count for _, count in sources])[:-1]
        parts = zip(sources, np.split(centres, ends), np.split(warps, ends), strict=True)
        patches = [_warped(image, of_these, A) for (image, count), of_these, A in parts if count]
        return _matched(np.concatenate(patches), target, guess)
    images = [np.ascontiguousarray(image) for image, _ in sources]
    places = np.repeat([image.ctypes.data for image in images], [count for _, count in sources])
    points, correlation, variance = np.array(guess, np.float32), np.empty(n, np.float32), np.empty((n, 2), np.float32)
    around, A = np.ascontiguousarray(centres, np.float32), np.ascontiguousarray(warps, np.float32)
    height, width = target.shape
    compiled(n, places, around, A, np.ascontiguousarray(target), width, height, _ROWS, points, correlation, variance)
    return PatchMatches(points, correlation, variance)


def _warped(image: GreyImage, centres: Points, warps: FloatArray) -> Float32Array:
    """Grey levels (n, 289) around the centres, with a border of one pixel for the gradients."""
    offsets = warps.astype(np.float32) @ np.stack(_grid(_HALF + 1))
    return _sampled(image, centres[:, :1] + offsets[:, 0], centres[:, 1:] + offsets[:, 1])


def _sampled(image: GreyImage, u: Float32Array, v: Float32Array) -> Float32Array:
    """Grey levels (n, m) by bilinear interpolation; outside the image those of its edge."""
    grey = cv2.remap(image.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(grey, dtype=np.float32)


def _matched(patches: Float32Array, target: GreyImage, guess: Points) -> PatchMatches:
    """Matches of warped patches (n, 289)."""
    n, side = len(patches), 2 * _HALF + 3
    wide = patches.reshape(n, side, side)
    across, down = 0.5 * (wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]), 0.5 * (wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1])
    levels = np.stack([across, down, wide[:, 1:-1, 1:-1]]).reshape(3, n, (side - 2) ** 2)
    levels -= (levels @ _WEIGHT)[..., None]
    weighted, deviation = levels * _WEIGHT, levels[2]
    gradients, pattern = weighted[:2], weighted[2]
    a, b, c = (np.vecdot(gradients[i], levels[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    inverse = np.array([[c, -b], [-b, a]]) / np.maximum(a * c - b * b, np.float32(_FLATTEST))
    offset, contrast = np.vecdot(gradients, deviation), _positive(np.vecdot(pattern, deviation))
    position, moving, correlation = guess.T.astype(np.float32), np.ones(n, np.bool_), np.zeros(n, np.float32)
    for k in range(_ITERATIONS + 1):
        grey = _sampled(target, position[0][:, None] + _U, position[1][:, None] + _V)
        there = _positive(np.square(grey) @ _WEIGHT - np.square(grey @ _WEIGHT))
        correlation = np.where(moving, np.vecdot(pattern, grey) / (contrast * there), correlation)
        if k == _ITERATIONS or not moving.any():
            break
        step = (inverse * (contrast / there * np.vecdot(gradients, grey) - offset)).sum(axis=1)
        position -= moving * step.clip(-_LONGEST_STEP, _LONGEST_STEP)
        moving &= np.abs(step).max(axis=0) > _DONE
    # the difference of two patches of equal contrast has the variance 2 contrast^2 (1 - correlation), twice that of one
    noise = np.maximum(contrast * np.sqrt(np.maximum(1.0 - correlation, 0.0)), _QUIETEST)
    variance = np.float32(_NOISE_SHARE) * np.square(noise) * inverse[[0, 1], [0, 1]]
    return PatchMatches(np.ascontiguousarray(position.T), correlation, np.ascontiguousarray(variance.T))


def _positive(variance: Float32Array) -> Float32Array:
    """Standard deviations (n,) of grey levels, always positive."""
    deviation: Float32Array = np.sqrt(np.maximum(variance, np.float32(_LEAST_CONTRAST**2)))
    return deviation
