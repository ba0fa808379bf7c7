"""Warped patches found to sub-pixels."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from estimators.odometry.warped_matching import WARPED, Patch, PatchMatches, match_patches
from estimators.stereo_pair import Points
from sensors.messages import GreyImage
from vehicle.frames import FloatArray

SHIFT = np.array([1.37, -0.62])  # [px]
STRAIGHT = np.eye(2)
SHEARED = np.array([[1.1, 0.17], [-0.05, 0.9]])  # offsets in the second image to offsets in the first


pytestmark = pytest.mark.usefixtures("back_end")


@pytest.fixture(scope="module")
def scene() -> GreyImage:
    """Smooth texture, some 8 px from crest to crest, so that interpolation is nearly exact."""
    noise = np.random.default_rng(0).standard_normal((300, 400)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return grey(120.0 + 25.0 * smooth / smooth.std())


def grey(levels: NDArray[np.floating[Any]]) -> GreyImage:
    return np.asarray(np.clip(np.rint(levels), 0, 255), dtype=np.uint8)


def centres() -> Points:
    u, v = np.meshgrid(np.arange(60.0, 340.0, 20.0), np.arange(60.0, 240.0, 20.0))
    return np.column_stack([u.ravel(), v.ravel()]).astype(np.float32)


def seen_through(image: GreyImage, A: FloatArray, about: Points) -> GreyImage:
    """The second image: around ``about`` + SHIFT it shows what the first has at A times the offset around ``about``.

    Cubic splines: OpenCV's own warp rounds to 1/32 px.
    """
    offset = (about - A @ (about + SHIFT))[::-1]
    return grey(ndimage.affine_transform(image.astype(np.float64), A[::-1, ::-1], offset, order=3, mode="nearest"))


def matched(
    first: GreyImage, second: GreyImage, points: Points, A: FloatArray, guess: Points | FloatArray
) -> PatchMatches:
    warps = np.broadcast_to(A, (len(points), 2, 2))
    return match_patches([(first, len(points))], points, warps, second, guess.astype(np.float32))


def test_shift_is_found_to_hundredths_of_a_pixel(scene: GreyImage) -> None:
    """No noise: what is left is the bilinear interpolation, which smooths unevenly."""
    points = centres()
    found = matched(scene, seen_through(scene, STRAIGHT, points[0]), points, STRAIGHT, points)
    error = found.points - points - SHIFT
    assert np.abs(error).max() < 0.06  # single patches
    assert np.abs(error.mean(axis=0)).max() < 0.01  # no bias
    assert found.correlation.min() > 0.98


def test_warp_is_what_finds_a_sheared_patch(scene: GreyImage) -> None:
    """The patch seen from elsewhere is found where it is; merely shifted it is less alike and less accurate."""
    errors, correlation = [], []
    for point in centres()[::7]:
        second = seen_through(scene, SHEARED, point)
        for A in (SHEARED, STRAIGHT):
            found = matched(scene, second, point[None], A, point[None] + 1.0)
            errors.append(np.linalg.norm(found.points[0] - point - SHIFT))
            correlation.append(float(found.correlation[0]))
    warped, shifted = np.array(errors)[::2], np.array(errors)[1::2]
    assert warped.max() < 0.06  # [px] as without a shear
    assert np.sqrt(np.mean(shifted**2)) > 3.0 * np.sqrt(np.mean(warped**2))
    assert min(correlation[::2]) > max(correlation[1::2])


def test_exposure_does_not_matter(scene: GreyImage) -> None:
    points = centres()
    second = seen_through(scene, STRAIGHT, points[0])
    same, brighter = (matched(scene, image, points, STRAIGHT, points) for image in (second, grey(0.6 * second + 30.0)))
    assert brighter.points == pytest.approx(same.points, abs=0.03)  # where the last step ends, and rounding
    assert brighter.correlation == pytest.approx(same.correlation, abs=1e-3)


def test_variance_is_that_of_the_spread(scene: GreyImage) -> None:
    """Noise of 2 grey levels in both images, as on rendered frames: normalised errors of unit size."""
    rng, points = np.random.default_rng(1), centres()
    second = seen_through(scene, STRAIGHT, points[0])
    normalised = []
    for _ in range(8):
        first, other = (grey(image + 2.0 * rng.standard_normal(image.shape)) for image in (scene, second))
        found = matched(first, other, points, STRAIGHT, points + SHIFT)
        normalised.append((found.points - points - SHIFT) / np.sqrt(found.variance))
    # the weights are not those of least squares, which the formula allows for only on average; and interpolation
    # smooths the noise
    assert np.sqrt(np.mean(np.square(normalised))) == pytest.approx(1.0, abs=0.25)


def test_plain_patches_are_finite_and_unlike() -> None:
    plain = np.full((100, 100), 90, np.uint8)
    points = np.array([[50.0, 50.0]], np.float32)
    found = matched(plain, plain, points, STRAIGHT, points)
    assert np.isfinite(found.points).all()
    assert found.correlation[0] < 0.5


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e30])
@pytest.mark.parametrize("which", ["centre", "warp", "guess"])
@pytest.mark.parametrize("patch", [WARPED, replace(WARPED, half=5)])
def test_numbers_out_of_range_find_nothing_and_disturb_no_other_patch(
    scene: GreyImage, bad: float, which: str, patch: Patch
) -> None:
    """As of points near the epipole of a displaced camera, which have no image; such a patch may lie anywhere."""
    points = centres()[:20]
    arguments: dict[str, Any] = {
        "centre": points.copy(),
        "warp": np.tile(STRAIGHT, (20, 1, 1)),
        "guess": points + np.float32(0.5),
    }
    arguments[which][3] = bad
    with np.errstate(all="ignore"):
        found = match_patches([(scene, 20)], arguments["centre"], arguments["warp"], scene, arguments["guess"], patch)
    others = np.arange(20) != 3
    assert np.abs(found.points - points)[others].max() < 0.05
    assert not found.correlation[3] > 0.9


def test_nothing_to_find() -> None:
    none = np.zeros((0, 2), np.float32)
    image = np.zeros((50, 50), np.uint8)
    assert len(matched(image, image, none, STRAIGHT, none).points) == 0


def test_both_back_ends_find_the_same(scene: GreyImage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Patches of two images, up to the edges of both, with guesses up to 2 px off: equal but for rounding."""
    rng = np.random.default_rng(2)
    points = rng.uniform([0.0, 0.0], [399.0, 299.0], (300, 2)).astype(np.float32)
    other, target = seen_through(scene, STRAIGHT, points[0]), grey(scene + 2.0 * rng.standard_normal(scene.shape))
    bent = STRAIGHT + 0.1 * rng.standard_normal((300, 2, 2))
    guess = (points + rng.uniform(-2.0, 2.0, points.shape)).astype(np.float32)
    one = match_patches([(scene, 200), (other, 100)], points, bent, target, guess)
    monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    same = match_patches([(scene, 200), (other, 100)], points, bent, target, guess)
    inside = ((points > 20.0) & (points < [379.0, 279.0])).all(axis=1)  # at the edge the last pixels differ
    off = np.abs(one.points - same.points).max(axis=1)
    assert np.percentile(off[inside], 98) < 1e-3  # [px] single precision; one in a hundred stops an iteration earlier
    assert off.max() < 10.0
    assert np.abs(one.correlation - same.correlation)[inside].max() < 1e-2
    assert np.percentile(np.abs(one.variance / same.variance - 1.0)[inside], 98) < 1e-2
