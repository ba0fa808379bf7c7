"""Planes around points from disparities, and the warps they make."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.odometry.image_points import Points, local_planes, rays_through, warps
from estimators.stereo_pair import project
from sensors.camera.rig import StereoCalibration
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
