"""Local plane around each point of a stereo view, fitted to the disparities of its neighbours.

A plane is given by n (3,) [1/m] with n . X = 1 for its points X in the camera. Then 1/Z = n . ray over the rays
(x, y, 1), and disparity is linear in the image; under X' = R X + t the plane's images map by the homography R + t n'.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimators.odometry.corners import Points
from sensors.camera.rig import StereoCalibration
from vehicle.frames import FloatArray

_HYPOTHESES = 150  # triples for the ground plane; enough if a third of the points lie on it
_TOLERANCE = 0.6  # disparity error of a point on the ground [px]
_STEEPEST_GROUND = 0.97  # cosine of 14 deg: slope, roll and pitch of the body together
_ON_GROUND, _ON_GROUND_SHARE = 0.8, 0.05  # tolerance for points on rough ground: [px], or share of the disparity
_NEIGHBOURS = 8  # points of a local fit, the point itself included
_FLAT = 2.0  # scale of vertical distances to neighbours: depth changes faster along v
_REACH = 70.0  # standard deviation of the Gaussian weight of neighbours over their distance [px]
_UNIT = 50.0  # length that slopes are scaled with, so that all unknowns have the same magnitude [px]
_PULL = 0.15  # weight of the expected slope relative to one neighbour at _UNIT
_ROUNDS = 3  # of re-weighting, which removes neighbours on other surfaces
_SCATTER, _SCATTER_SHARE = 0.25, 0.01  # residual that halves a neighbour's weight: [px] plus share of the disparity
_AGREEING = 0.35  # least share of the neighbours' weight that remains in a planar neighbourhood
_MISFIT, _MISFIT_SHARE = 0.5, 0.02  # largest residual of the point itself: [px] plus share of the disparity
_STEEPEST = np.array([0.25, 0.35])  # largest slopes along u and v of a patch that can be matched


def local_planes(
    calibration: StereoCalibration, points: Points, disparity: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Planes n (n, 3) [1/m] through the points (n, 2) with their disparities (n,) [px].

    Each plane is fitted to the disparities nearby, with a prior: the ground for points that lie on it, a plane facing
    the camera for all others. If no plane fits, the prior is returned.
    """
    expected = _expected_slopes(calibration, points, disparity, rng)
    slopes, flat = _fitted_slopes(points, disparity, expected)
    return _through(calibration, points, disparity, np.where(flat[:, None], slopes, expected))


def warps(R: FloatArray, t: FloatArray, planes: FloatArray, rays: FloatArray) -> FloatArray:
    """Warps (..., 2, 2): image offsets in a second camera mapped to offsets in the camera of the planes and rays.

    X' = R X + t transforms points into the second camera; R (..., 3, 3), t, planes and rays (..., 3) broadcast. The
    warp is the inverse of the Jacobian of x' = (H x) / (H x)_z, H = R + t n'.
    """
    H = R + t[..., None] * planes[..., None, :]
    mapped = np.einsum("...ij,...j->...i", H, rays)
    forward = (H[..., :2, :2] - (mapped[..., :2] / mapped[..., 2:])[..., None] * H[..., 2:, :2]) / mapped[..., 2:, None]
    determinant = forward[..., 0, 0] * forward[..., 1, 1] - forward[..., 0, 1] * forward[..., 1, 0]
    backward: FloatArray = np.empty_like(forward)
    backward[..., 0, 0], backward[..., 1, 1] = forward[..., 1, 1], forward[..., 0, 0]
    backward[..., 0, 1], backward[..., 1, 0] = -forward[..., 0, 1], -forward[..., 1, 0]
    backward /= determinant[..., None, None]
    return backward


def rays_through(calibration: StereoCalibration, points: Points | FloatArray) -> FloatArray:
    """Rays (n, 3) of depth 1 through image points (n, 2)."""
    rays = np.ones((len(points), 3))
    rays[:, :2] = (points - np.array([calibration.cx, calibration.cy])) / calibration.focal_length
    return rays


def _expected_slopes(
    calibration: StereoCalibration, points: Points, disparity: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Prior slopes (n, 2) of the disparity: those of the ground plane for points on it, otherwise 0."""
    rays = rays_through(calibration, points)
    inverse_depth = disparity / (calibration.focal_length * calibration.baseline)
    ground = _ground(calibration, rays, inverse_depth, rng)
    if ground is None:
        return np.zeros((len(points), 2))
    error = np.abs(inverse_depth - rays @ ground) * calibration.focal_length * calibration.baseline
    on_ground = error < np.maximum(_ON_GROUND, _ON_GROUND_SHARE * disparity)
    return np.where(on_ground[:, None], calibration.baseline * ground[:2], 0.0)


def _ground(
    calibration: StereoCalibration, rays: FloatArray, inverse_depth: FloatArray, rng: np.random.Generator
) -> FloatArray | None:
    """Nearly level plane n (3,) with the most points on it, by RANSAC; None if there is none."""
    if len(rays) < 3:
        return None
    down = -calibration.X_SC[2, :3]
    triples = rng.integers(0, len(rays), (_HYPOTHESES, 3))
    regular = np.abs(np.linalg.det(rays[triples])) > 1e-6  # three rays in one plane define nothing
    planes = np.linalg.solve(rays[triples][regular], inverse_depth[triples][regular][..., None])[..., 0]
    planes = planes[planes @ down > _STEEPEST_GROUND * np.linalg.norm(planes, axis=1)]
    if len(planes) == 0:
        return None
    tolerance = _TOLERANCE / (calibration.focal_length * calibration.baseline)
    agreeing = np.abs(rays @ planes.T - inverse_depth[:, None]) < tolerance
    chosen = agreeing[:, np.argmax(np.count_nonzero(agreeing, axis=0))]
    best: FloatArray = np.linalg.lstsq(rays[chosen], inverse_depth[chosen], rcond=None)[0]
    return best


def _fitted_slopes(points: Points, disparity: FloatArray, expected: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Slopes (n, 2) of the disparity around each point, and a mask (n,) of planar neighbourhoods."""
    if len(points) <= _NEIGHBOURS:
        return expected, np.zeros(len(points), np.bool_)
    distance, near = cKDTree(points * [1.0, _FLAT]).query(points * [1.0, _FLAT], _NEIGHBOURS)
    design = np.concatenate([(points[near] - points[:, None]) / _UNIT, np.ones((*near.shape, 1))], axis=2)
    closeness = np.exp(-0.5 * (distance / _REACH) ** 2)
    weight = closeness
    tolerance = (_SCATTER + _SCATTER_SHARE * disparity)[:, None]
    for _ in range(_ROUNDS):
        weighted = design * weight[..., None]
        normal = weighted.transpose(0, 2, 1) @ design + np.diag([_PULL, _PULL, 1e-6])
        right = np.einsum("nki,nk->ni", weighted, disparity[near])
        right[:, :2] += _PULL * _UNIT * expected
        fit = np.asarray(np.linalg.solve(normal, right[..., None]), dtype=np.float64)[..., 0]
        misfit = disparity[near] - np.einsum("nki,ni->nk", design, fit)
        weight = closeness / (1.0 + (misfit / tolerance) ** 2)
    slopes = fit[:, :2] / _UNIT
    agreeing = weight.sum(axis=1) > _AGREEING * closeness.sum(axis=1)
    through = np.abs(disparity - fit[:, 2]) < _MISFIT + _MISFIT_SHARE * disparity
    return slopes, agreeing & through & np.all(np.abs(slopes) < _STEEPEST, axis=1)


def _through(calibration: StereoCalibration, points: Points, disparity: FloatArray, slopes: FloatArray) -> FloatArray:
    """Planes (n, 3) through the points with the slopes of their disparity."""
    rays = rays_through(calibration, points)
    planes = np.empty((len(points), 3))
    planes[:, :2] = slopes / calibration.baseline
    inverse_depth = disparity / (calibration.focal_length * calibration.baseline)
    planes[:, 2] = inverse_depth - np.einsum("ni,ni->n", planes[:, :2], rays[:, :2])
    return planes
