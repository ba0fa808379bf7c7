"""Image noise and the frames that a stereo camera sends."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sensors.camera.image_formation import NoiseBank, grey
from sensors.camera.rig import StereoCalibration
from sensors.camera.stereo_camera import StereoCamera
from sensors.messages import ColourImage
from tests.trailers import truth
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

SHAPE = (391, 1344)
MID_GREY = np.full(SHAPE, 128, dtype=np.uint8)
PIXELS = MID_GREY.size


@pytest.mark.parametrize("std", [1.0, 2.0, 6.0])
def test_noise_has_the_asked_spread_and_no_mean(std: float) -> None:
    """Rounding to whole grey levels adds its variance of 1/12, as in any camera."""
    rng = np.random.default_rng(3)
    noise = NoiseBank.draw(rng, std, PIXELS).added_to(MID_GREY, rng).astype(float) - 128.0
    expected = math.hypot(std, math.sqrt(1.0 / 12.0))
    assert abs(noise.mean()) < 5.0 * expected / math.sqrt(PIXELS)  # five standard errors of the mean
    assert noise.std() == pytest.approx(expected, rel=0.01)  # ten standard errors


def test_noise_of_any_two_images_is_uncorrelated() -> None:
    """Left and right, and one frame and the next, each get noise of their own; so does each pixel."""
    rng = np.random.default_rng(4)
    bank = NoiseBank.draw(rng, 4.0, PIXELS)
    images = [bank.added_to(MID_GREY, rng).astype(float) - 128.0 for _ in range(6)]
    between = np.corrcoef([image.ravel() for image in images]) - np.eye(6)
    limit = 5.0 / math.sqrt(PIXELS)  # five standard errors of a correlation of independent pixels
    assert np.abs(between).max() < limit
    for neighbour in (images[0][:, 1:] * images[0][:, :-1], images[0][1:] * images[0][:-1]):
        assert abs(neighbour.mean()) / images[0].var() < limit


def test_noise_saturates_instead_of_wrapping() -> None:
    rng = np.random.default_rng(5)
    bank = NoiseBank.draw(rng, 5.0, PIXELS)
    assert bank.added_to(np.full(SHAPE, 255, dtype=np.uint8), rng).min() > 200  # 255 - 11 deviations
    assert bank.added_to(np.zeros(SHAPE, dtype=np.uint8), rng).max() < 55


def test_green_is_the_brightest_primary() -> None:
    """Luminance weighs red, green and blue with 0.299, 0.587, 0.114: the order of the channels is pinned."""
    primaries = (255 * np.eye(3, dtype=np.uint8)).reshape(1, 3, 3)
    np.testing.assert_allclose(grey(primaries)[0], [76, 150, 29], atol=1)  # one level of rounding


class _Painted:
    """A renderer whose images tell the x of the pose they were asked for."""

    def __init__(self, calibration: StereoCalibration) -> None:
        self.calibration = calibration

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        left = np.full((*SHAPE, 3), int(X_WB[0, 3]), dtype=np.uint8)
        return left, left + np.uint8(1)


def _truth(tick: int) -> Truth:
    """Two units whose bodies are at x = 10 m and x = 20 m."""
    bodies = np.tile(np.eye(4), (2, 1, 1))
    bodies[:, 0, 3] = 10.0, 20.0
    return truth(tick, bodies=bodies)


@pytest.mark.parametrize("keep_colour", [False, True])
def test_frame_is_what_the_cameras_on_the_unit_saw(calibration: StereoCalibration, keep_colour: bool) -> None:
    """Stamped with the capture tick; left and right not swapped; colour only when asked for."""
    camera = StereoCamera(
        renderer=_Painted(calibration), unit=1, noise_std=0.0, rng=np.random.default_rng(0), keep_colour=keep_colour
    )
    frame = camera.sample(_truth(70))
    assert frame.tick == 70
    assert (frame.left == 20).all()
    assert (frame.right == 21).all()
    assert (frame.colour is not None) == keep_colour
    assert camera.calibration is calibration
