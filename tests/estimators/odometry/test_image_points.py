"""Points of an image: planes around them from disparities, the warps these make, corners, and tracking."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from estimators.odometry.image_points import (
    LEVELS,
    detect_corners,
    disparity_guess,
    local_planes,
    rays_through,
    track,
    warps,
)
from estimators.stereo_pair import Points, project
from sensors.camera.rig import StereoCalibration
from sensors.textures import fractal_noise
from vehicle.frames import FloatArray, rotation_zyx


def seen(
    calibration: StereoCalibration, points: FloatArray, rng: np.random.Generator, std: float
) -> tuple[Points, FloatArray]:
    """Left images (n, 2) and disparities (n,) with noise."""
    z = project(calibration, points)
    return z[:, :2].astype(np.float32), z[:, 0] - z[:, 2] + std * rng.standard_normal(len(z))


def on_the_ground(calibration: StereoCalibration, rng: np.random.Generator, count: int, tilt: float) -> FloatArray:
    """Points of a ground that falls to one side by ``tilt``, as the level camera at its height sees it."""
    z = rng.uniform(6.0, 30.0, count)
    x = rng.uniform(-0.9, 0.9, count) * z
    return np.column_stack([x, calibration.X_SC[2, 3] + tilt * x, z])


def slope_error(planes: FloatArray, n: FloatArray, calibration: StereoCalibration) -> FloatArray:
    """Error of the disparity's slopes (m, 2): what shears a patch [px/px]."""
    return calibration.baseline * np.abs(planes[:, :2] - n[:2])


@pytest.mark.parametrize("tilt", [0.0, 0.04])
def test_planes_on_the_ground_are_the_ground(calibration: StereoCalibration, tilt: float) -> None:
    """Level or falling to a side: slopes within a hundredth, which shears a 15 px patch by a tenth of a pixel."""
    rng = np.random.default_rng(0)
    points, disparity = seen(calibration, on_the_ground(calibration, rng, 300, tilt), rng, 0.1)
    planes = local_planes(calibration, points, disparity, rng)
    n = np.array([-tilt, 1.0, 0.0]) / calibration.X_SC[2, 3]
    assert np.median(slope_error(planes, n, calibration), axis=0).max() < 0.005
    assert np.percentile(slope_error(planes, n, calibration), 90) < 0.015


def test_disparities_are_guessed_as_of_the_ground_and_of_scenery_above_it(calibration: StereoCalibration) -> None:
    """Scenery is taken to be 30 m away."""
    ground = on_the_ground(calibration, np.random.default_rng(0), 20, 0.0)
    scenery = np.array([[2.0, -3.0, 30.0]])
    for points in (ground, scenery):
        z = project(calibration, points)
        guess = disparity_guess(calibration, z[:, :2].astype(np.float32))
        assert guess == pytest.approx(np.column_stack([z[:, 0] - z[:, 2], np.zeros(len(z))]), rel=1e-4)


def test_planes_pass_through_their_points(calibration: StereoCalibration) -> None:
    """n . X = 1 at the point itself, whatever lies around it."""
    rng = np.random.default_rng(1)
    X = np.column_stack([rng.uniform(-8, 8, 80), rng.uniform(-3, 3, 80), rng.uniform(8, 30, 80)])
    points, disparity = seen(calibration, X, rng, 0.0)
    planes = local_planes(calibration, points, disparity, rng)
    assert np.einsum("ni,ni->n", planes, X) == pytest.approx(np.ones(80), abs=1e-5)  # images in single precision


def test_a_wall_is_fitted_as_a_wall_and_scattered_points_face_the_camera(calibration: StereoCalibration) -> None:
    """A slanted wall has its own slope; single things at all depths have none."""
    rng = np.random.default_rng(2)
    u, v = np.meshgrid(np.linspace(-0.4, 0.0, 16), np.linspace(-0.25, -0.05, 8))
    n = np.array([0.05, 0.0, 0.08])  # a wall 45 deg or so to the side
    rays = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    points, disparity = seen(calibration, rays / (rays @ n)[:, None], rng, 0.03)
    assert np.median(slope_error(local_planes(calibration, points, disparity, rng), n, calibration)) < 0.005
    X = rays * rng.uniform(8.0, 60.0, (len(rays), 1))
    points, disparity = seen(calibration, X, rng, 0.0)
    planes = local_planes(calibration, points, disparity, rng)
    assert np.mean(np.abs(planes[:, :2]).max(axis=1) == 0.0) > 0.7


def test_few_points_face_the_camera(calibration: StereoCalibration) -> None:
    """Too few for a neighbourhood, too few for a ground: no slopes, no error."""
    rng = np.random.default_rng(3)
    for count in (0, 2, 5):
        X = np.column_stack([np.zeros(count), np.full(count, -1.0), np.linspace(10.0, 50.0, count)])
        points, disparity = seen(calibration, X, rng, 0.0)
        planes = local_planes(calibration, points, disparity, rng)
        assert planes.shape == (count, 3)
        assert np.all(planes[:, :2] == 0.0)


def test_warp_takes_offsets_back(calibration: StereoCalibration) -> None:
    """Points on the plane around a point, projected into the moved camera: the warp leads their offsets back."""
    R, t = rotation_zyx(0.02, -0.1, 0.03), np.array([0.3, 0.05, 2.0])
    n = np.array([0.02, 0.3, 0.01])
    centre = np.array([[700.0, 280.0]])
    step = 0.01  # [px] small, so that the homography is straight
    corners = (centre + step * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])).astype(np.float64)
    rays = rays_through(calibration, corners)
    there = project(calibration, rays / (rays @ n)[:, None] @ R.T + t)[:, :2]
    A = warps(R, t, n[None], rays_through(calibration, centre))[0]
    back = (there[1:] - there[0]) @ A.T
    assert back == pytest.approx(step * np.eye(2), abs=1e-3 * step)  # second order of the homography


# Corners, by buckets


def test_corners_of_a_square_are_found() -> None:
    image = np.full((200, 300), 50, np.uint8)
    image[60:121, 80:181] = 180
    corners = detect_corners(image, per_bucket=4)
    expected = np.array([[79.5, 59.5], [180.5, 59.5], [79.5, 120.5], [180.5, 120.5]])  # edges of the pixels
    assert len(corners) == 4
    distance = np.linalg.norm(corners[:, None] - expected[None], axis=2)
    assert distance.min(axis=0).max() < 4.0  # [px] the tracker's window is 11


def test_no_bucket_holds_more_than_its_share() -> None:
    """Texture everywhere: every bucket of 50 x 50 px is full, none overflows."""
    image = np.random.default_rng(0).integers(0, 255, (200, 300), dtype=np.uint8)
    corners = detect_corners(image, per_bucket=3)
    _, counts = np.unique(corners // 50, axis=0, return_counts=True)
    assert len(counts) == 24
    assert counts.max() == 3
    assert counts.min() == 3


def test_strongest_corners_are_kept() -> None:
    image = np.full((100, 100), 100, np.uint8)
    image[20:24, 20:24] = 130
    image[20:24, 36:40] = 255
    corners = detect_corners(image, per_bucket=1)
    assert np.abs(corners - [37.5, 21.5]).max() < 3.0  # [px]


def test_darkness_and_its_noise_have_no_corners() -> None:
    """A black image has none, and neither has the sensor noise of 2 grey levels on a plain surface."""
    assert len(detect_corners(np.zeros((391, 1344), np.uint8), per_bucket=4)) == 0
    noise = 2.0 * np.random.default_rng(0).standard_normal((391, 1344))
    plain = np.clip(np.rint(120.0 + noise), 0, 255).astype(np.uint8)
    assert len(detect_corners(plain, per_bucket=4)) < 50  # a handful of coincidences in 216 buckets


# Tracking


@pytest.mark.usefixtures("back_end")
def test_points_are_tracked_over_forty_pixels_and_another_exposure() -> None:
    """From coarse to fine; the finest level alone does not reach that far."""
    rng, shift = np.random.default_rng(0), np.array([-36.4, 14.7])
    rough = fractal_noise(rng, (300, 400), 1.5, (0.005, 0.25)).astype(np.float64)
    source = np.clip(120.0 + 30.0 * rough / rough.std(), 0, 255).astype(np.uint8)
    moved = ndimage.shift(source.astype(np.float64), shift[::-1], order=3, mode="reflect")
    target = np.clip(np.rint(0.8 * moved + 12.0 + rng.normal(0.0, 1.0, moved.shape)), 0, 255).astype(np.uint8)
    points = rng.uniform([80.0, 60.0], [340.0, 240.0], (200, 2)).astype(np.float32)
    there, found = track(source, target, points, points, LEVELS)
    off = np.abs(there - points - shift).max(axis=1)[found]
    assert found.mean() > 0.9
    assert np.percentile(off, 95) < 0.15  # [px]
    assert np.median(off) < 0.04
    there, _ = track(source, target, points, points, 0)
    assert np.median(np.abs(there - points - shift)) > 5.0


@pytest.mark.usefixtures("back_end")
def test_points_that_leave_the_image_or_lie_on_plain_ground_are_not_found() -> None:
    noise = np.random.default_rng(0).standard_normal((120, 200)).astype(np.float32)
    image = np.clip(np.rint(120.0 + 60.0 * cv2.GaussianBlur(noise, (0, 0), 1.5)), 0, 255).astype(np.uint8)
    image[40:80, 80:120] = 120
    places = np.array([[30.0, 60.0], [100.0, 60.0], [3.0, 60.0]], np.float32)
    target = np.roll(image, -10, axis=1)
    there, found = track(image, target, places, places - np.array([10.0, 0.0], np.float32), 0)
    assert found.tolist() == [True, False, False]
    assert there[0] == pytest.approx([20.0, 60.0], abs=0.02)
    assert len(track(image, target, places[:0], places[:0], LEVELS)[0]) == 0
    for bad in (np.nan, np.inf, -1e30):  # as of points near the epipole of a displaced camera
        wrong = np.where([[True], [False], [False]], np.float32(bad), places)
        assert not track(image, target, places, wrong, LEVELS)[1][0]
        assert track(image, target, wrong, places, LEVELS)[0].shape == places.shape
