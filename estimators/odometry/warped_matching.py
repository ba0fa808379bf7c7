"""Matching of square patches to sub-pixels: warped by their local plane, or as they are.

Inverse-compositional Gauss-Newton on the shift of the patch: gradients are computed on the template, once. Mean and
gain of every patch are normalised, so the exposure may change. Without the warp a patch on the ground is sheared by the
slope of the disparity (baseline over height): 0.09 px of bias and ten times the off-tracking error. Points that are
tracked, before planes are known, have smaller patches, which shear less.

It is compiled C (``patches.c``); without a C compiler OpenCV and NumPy do the same in several times the time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.stereo_pair import Points
from sensors.messages import GreyImage
from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray

_QUIETEST = 1.5  # least assumed noise of an image; residuals of single patches are smaller by chance [grey levels]
_FLATTEST = 1e-3  # least determinant of the structure tensor, for patches without texture [grey levels^4/px4]
_LEAST_CONTRAST = 1e-3  # keeps the gain of a uniform patch finite [grey levels]
_LANES = 16  # pixels of a row in the compiled code; those beyond the patch weigh nothing

Float32Array = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Patch:
    """Shape of square patches, and how they are located."""

    half: int  # of 2 half + 1 pixels
    spread: float  # standard deviation of the Gaussian weights [px]
    iterations: int  # at most
    done: float  # step at convergence; the next would be a fifth of it [px]
    longest_step: float  # of an iteration; far beyond 1 px the gradients of the template are not valid [px]

    def offsets(self, border: int = 0) -> Float32Array:
        """Offsets u and v (2, m) of the pixels, row by row."""
        reach = self.half + border
        v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float32)
        return np.stack([u.ravel(), v.ravel()])

    @cached_property
    def weight(self) -> Float32Array:
        """Weights (m,) of the pixels; their sum is 1."""
        bell = np.exp(-np.square(self.offsets()).sum(axis=0) / np.float32(2.0 * self.spread**2))
        return np.asarray(bell / bell.sum(), dtype=np.float32)

    @cached_property
    def noise_share(self) -> float:
        """Variance of the weighted grey level relative to a pixel's; both images are noisy."""
        return 2.0 * float(np.square(self.weight).sum())

    @cached_property
    def rows(self) -> Float32Array:
        """Weights row by row, padded with zeros to the compiled code's lanes."""
        side = 2 * self.half + 1
        return np.pad(self.weight.reshape(side, side), ((0, 0), (0, _LANES - side)))

    @cached_property
    def numbers(self) -> tuple[str, ...]:
        """Macros of the compiled code."""
        return (
            *(f"HALF={self.half}", f"ITERATIONS={self.iterations}", f"DONE={self.done}f"),
            *(f"LONGEST_STEP={self.longest_step}f", f"QUIETEST={_QUIETEST}f", f"FLATTEST={_FLATTEST}f"),
            *(f"LEAST_CONTRAST={_LEAST_CONTRAST}f", f"NOISE_SHARE={self.noise_share}f", f"LANES={_LANES}"),
        )


WARPED = Patch(half=7, spread=4.2, iterations=5, done=0.02, longest_step=1.0)  # most converge after three iterations
MARGIN = WARPED.half + 2  # least distance of a patch's centre from the image's edge [px]


class PatchMatches(NamedTuple):
    """Positions of matched patches and their quality."""

    points: Points  # (n, 2)
    correlation: Float32Array  # (n,) normalised, at most 1; before a patch's last step, which is short by then
    variance: Float32Array  # (n, 2) of u and v, from texture and noise of the patch [px2]


def match_patches(
    sources: Sequence[tuple[GreyImage, int]],
    centres: Points,
    warps: FloatArray | None,
    target: GreyImage,
    guess: Points,
    patch: Patch = WARPED,
) -> PatchMatches:
    """Locate patches in the target image, each near its guess (n, 2): 5 px away at most.

    Args:
        sources: images of the size of the target, each with its number of patches, in the order of the patches.
        centres: of the patches in their images (n, 2) [px].
        warps: (n, 2, 2) map offsets in the target to offsets in the patch's image; None: they are the same. Such
            patches have at most 13 x 13 px.
        target: image in which the patches are located.
        guess: (n, 2) [px].
        patch: their shape.
    """
    n, compiled = len(guess), kernel("estimators.odometry", "patches.c", "match", patch.numbers)
    if n == 0:
        return PatchMatches(guess, np.empty(0, np.float32), np.empty((0, 2), np.float32))
    if compiled is None:
        bent = np.broadcast_to(np.eye(2), (n, 2, 2)) if warps is None else warps
        ends = np.cumsum([count for _, count in sources])[:-1]
        parts = zip(sources, np.split(centres, ends), np.split(bent, ends), strict=True)
        patches = [_warped(patch, image, of_these, A) for (image, count), of_these, A in parts if count]
        return _matched(patch, np.concatenate(patches), target, guess)
    images = [np.ascontiguousarray(image) for image, _ in sources]
    places = np.repeat([image.ctypes.data for image in images], [count for _, count in sources])
    points, correlation, variance = np.array(guess, np.float32), np.empty(n, np.float32), np.empty((n, 2), np.float32)
    around, A = np.ascontiguousarray(centres, np.float32), 0 if warps is None else np.ascontiguousarray(warps, "f4")
    sizes = reversed(target.shape)
    compiled(n, places, around, A, np.ascontiguousarray(target), *sizes, patch.rows, points, correlation, variance)
    return PatchMatches(points, correlation, variance)


def _warped(patch: Patch, image: GreyImage, centres: Points, warps: FloatArray) -> Float32Array:
    """Grey levels (n, m) around the centres, with a border of one pixel for the gradients."""
    offsets = warps.astype(np.float32) @ patch.offsets(border=1)
    return _sampled(image, centres[:, :1] + offsets[:, 0], centres[:, 1:] + offsets[:, 1])


def _sampled(image: GreyImage, u: Float32Array, v: Float32Array) -> Float32Array:
    """Grey levels (n, m) by bilinear interpolation; outside the image those of its edge."""
    grey = cv2.remap(image.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(grey, dtype=np.float32)


def _matched(patch: Patch, patches: Float32Array, target: GreyImage, guess: Points) -> PatchMatches:
    """Matches of warped patches (n, m), which have a border."""
    n, side, (U, V) = len(patches), 2 * patch.half + 3, patch.offsets()
    wide = patches.reshape(n, side, side)
    across, down = 0.5 * (wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]), 0.5 * (wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1])
    levels = np.stack([across, down, wide[:, 1:-1, 1:-1]]).reshape(3, n, (side - 2) ** 2)
    levels -= (levels @ patch.weight)[..., None]
    weighted, deviation = levels * patch.weight, levels[2]
    gradients, pattern = weighted[:2], weighted[2]
    a, b, c = (np.vecdot(gradients[i], levels[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    determinant = np.maximum(a * c - b * b, np.float32(_FLATTEST))
    inverse = np.array([[c, -b], [-b, a]]) / determinant
    offset, contrast = np.vecdot(gradients, deviation), _positive(np.vecdot(pattern, deviation))
    position, moving, correlation = guess.T.astype(np.float32), np.ones(n, np.bool_), np.zeros(n, np.float32)
    for k in range(patch.iterations + 1):
        grey = _sampled(target, position[0][:, None] + U, position[1][:, None] + V)
        there = _positive(np.square(grey) @ patch.weight - np.square(grey @ patch.weight))
        correlation = np.where(moving, np.vecdot(pattern, grey) / (contrast * there), correlation)
        if k == patch.iterations or not moving.any():
            break
        step = (inverse * (contrast / there * np.vecdot(gradients, grey) - offset)).sum(axis=1)
        position -= moving * step.clip(-patch.longest_step, patch.longest_step)
        moving &= np.abs(step).max(axis=0) > patch.done
    # the difference of two patches of equal contrast has the variance 2 contrast^2 (1 - correlation), twice that of one
    noise = np.maximum(contrast * np.sqrt(np.maximum(1.0 - correlation, 0.0)), _QUIETEST)
    steepness = np.maximum([c, a], np.float32(np.sqrt(_FLATTEST)))
    variance = np.float32(patch.noise_share) * np.square(noise) * steepness / determinant
    return PatchMatches(np.ascontiguousarray(position.T), correlation, np.ascontiguousarray(variance.T))


def _positive(variance: Float32Array) -> Float32Array:
    """Standard deviations (n,) of grey levels, always positive."""
    deviation: Float32Array = np.sqrt(np.maximum(variance, np.float32(_LEAST_CONTRAST**2)))
    return deviation
