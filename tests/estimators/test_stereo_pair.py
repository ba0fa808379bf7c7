"""Images of a right camera that is not where it was calibrated."""

import numpy as np
import pytest

from estimators.stereo_pair import as_calibrated, displaced, image_shift
from sensors.camera.rig import StereoCalibration
from tests.estimators.calibration.test_late_right_camera import SHIFTS, points, rays
from vehicle.frames import FloatArray


@pytest.mark.parametrize("shift", SHIFTS)
def test_displaced_images_are_those_of_the_displaced_camera(calibration: StereoCalibration, shift: FloatArray) -> None:
    """There and back, against projections; near the epipole nothing is said."""
    p = points(np.random.default_rng(4))
    p = p[p[:, 2] - shift[2] > 3.0]

    def pixels(position: FloatArray) -> FloatArray:
        return calibration.focal_length * rays(p - position) + [calibration.cx, calibration.cy]

    left, b = pixels(np.zeros(3)), np.array([calibration.baseline, 0.0, 0.0])
    calibrated, late = pixels(b), pixels(b + shift)
    np.testing.assert_allclose(displaced(calibration, left, calibrated, shift), late, atol=1e-8)
    np.testing.assert_allclose(image_shift(calibration, p, shift), late - calibrated, atol=1e-8)
    back = as_calibrated(calibration, left, late, shift)
    known = np.isfinite(back).all(axis=1)
    np.testing.assert_allclose(back[known], calibrated[known], atol=1e-8)
    assert known.mean() > 0.6
    np.testing.assert_array_equal(as_calibrated(calibration, left, calibrated, None), calibrated)
    aside, lower = np.array([0.03, 0.0, 0.0]), [0.0, 0.3]  # an image below its epipolar line stays below it
    seen = as_calibrated(calibration, left, pixels(b + aside) + lower, aside)
    np.testing.assert_allclose(seen, calibrated + lower, atol=1e-8)
