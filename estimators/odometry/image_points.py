"""Points of stereo images: corner detection, tracking, and the local plane around each point.

Circular matching tracks corners through the previous and current, left and right image, back to the start. It follows
VISO2-S as in de Saxe 2018, section 2.1, steps 1 to 3, with sub-pixel tracks in place of descriptors. Points are tracked
as by Lucas and Kanade (1981), from coarse to fine images.

A plane is given by n (3,) [1/m] with n . X = 1 for its points X in the camera. Then 1/Z = n . ray over the rays
(x, y, 1), and disparity is linear in the image; under X' = R X + t the plane's images map by the homography R + t n'.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from estimators.odometry.warped_matching import Patch, match_patches
from estimators.stereo_pair import NEAREST, Points, as_calibrated, displaced, project, right_shift, triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray

_BUCKET = 50  # de Saxe 2018, section 3.1 [px]
_BLOCK = 3  # window of the structure tensor, in pixels of the halved image
_APART = 5  # non-maximum suppression window, in pixels of the halved image
_WEAKEST = 1e-4  # smallest accepted least eigenvalue; sensor noise of 2 grey levels gives about a tenth of it
_BORDER = 6  # no corners nearer to the edge: the tracker's window must fit, in pixels of the halved image


def detect_corners(image: GreyImage, *, per_bucket: int) -> Points:
    """Detect the strongest corners (least eigenvalue of the structure tensor), at most ``per_bucket`` per bucket.

    Detection works on the image at half size, in a fifth of the time: the tracker's windows of 11 px do not need
    corners located to a pixel.
    """
    strength = np.asarray(cv2.cornerMinEigenVal(half_size(image), _BLOCK), dtype=np.float32)
    neighbours = np.ones((_APART, _APART), np.uint8)
    is_maximum = (strength >= cv2.dilate(strength, neighbours)) & (strength > _WEAKEST)
    inside = is_maximum[_BORDER:-_BORDER, _BORDER:-_BORDER]
    found = cv2.findNonZero(inside.astype(np.uint8)) if inside.any() else None  # a fifth of the time of np.nonzero
    u, v = (np.empty((0, 2)) if found is None else np.asarray(found)).astype(np.int32).reshape(-1, 2).T + _BORDER
    points = in_full(np.stack([u, v], axis=1).astype(np.float32))
    return points[strongest_in_buckets(points, strength[v, u], per_bucket)]


def half_size(image: GreyImage) -> GreyImage:
    """Image at half size."""
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def in_full(points: Points) -> Points:
    """Points of the halved image in the full one."""
    return 2.0 * points + np.float32(0.5)


def in_half(points: Points) -> Points:
    """Points in the image of half the size."""
    return 0.5 * (points - np.float32(0.5))


def strongest_in_buckets(
    points: NDArray[np.floating[Any]], strength: NDArray[np.float32], count: int, side: int = _BUCKET
) -> NDArray[np.intp]:
    """Indices of the ``count`` strongest of the points (n, 2) in each square bucket, ``side`` [px] wide."""
    column, row = (points.T / side).astype(np.int64)
    bucket = row * (column.max(initial=0) + 1) + column
    order = np.lexsort((-strength, bucket))
    position = np.arange(len(order))
    new = np.diff(bucket[order], prepend=-1) > 0
    rank = position - np.maximum.accumulate(np.where(new, position, 0))
    return order[rank < count]


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
    # components before points, as in ``estimators.stereo_pair``
    H = np.moveaxis(R + t[..., None] * planes[..., None, :], (-2, -1), (0, 1))
    x, y, z = H[:, 0] * rays[..., 0] + H[:, 1] * rays[..., 1] + H[:, 2] * rays[..., 2]
    (a, b), (c, d) = (H[:2, :2] - (np.array([x, y]) / z)[:, None] * H[2, :2]) / z
    return np.moveaxis(np.array([[d, -b], [-c, a]]) / (a * d - b * c), (0, 1), (-2, -1))


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
    distance, near = scipy.spatial.cKDTree(points * [1.0, _FLAT]).query(points * [1.0, _FLAT], _NEIGHBOURS)
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


_CLOSURE = 0.6  # largest distance between start and end of the circle; 0.3 costs matches in fast turns [px]
LEVELS = 4  # pyramid levels above the image, for guesses wrong by up to some 40 px
LEVELS_NEAR = 1  # the same, for guesses wrong by noise alone
# 15 px shear more on the ground and double the off-tracking error, 9 px are not better; equal weights
_TRACKED = Patch(half=5, spread=np.inf, iterations=8, done=0.05, longest_step=4.0)
_VAGUE = 0.25  # largest variance of a tracked point along an axis [px2]
_EPIPOLAR = 1.2  # largest difference of the rows in left and right: tracking error and 0.1 deg of mis-rotation [px]
_LEAST_DISPARITY = 0.5  # farther points carry no information on the translation, and their depth is biased [px]
_SCENERY_DEPTH = 30.0  # initial guess of the depth of points above the ground [m]


def track(
    source: GreyImage, target: GreyImage, points: Points, guess: Points, levels: int
) -> tuple[Points, NDArray[np.bool_]]:
    """Track points from the source to the target image, near the guess; the mask (n,) tells which were found.

    Found are points with texture that end inside the image; whether it is the same texture, tracking back tells.
    """
    if levels > 0 and min(target.shape) > 4 * _TRACKED.half + 2:  # smaller ones hold no patch at half size
        guess, _ = track_halved(source, target, points, guess, levels)
    matched = match_patches([(source, len(points))], points, None, target, guess, _TRACKED)
    high = np.array([target.shape[1] - 1, target.shape[0] - 1])
    found = (matched.points >= 0.0) & (matched.points <= high) & (matched.variance < _VAGUE)
    return matched.points, np.logical_and.reduce(found, axis=1)


def track_halved(
    source: GreyImage, target: GreyImage, points: Points, guess: Points, levels: int
) -> tuple[Points, NDArray[np.bool_]]:
    """Track as by ``track``, in halved images: a third of the time, with errors of some tenths of a pixel."""
    tracked, found = track(half_size(source), half_size(target), in_half(points), in_half(guess), levels - 1)
    return in_full(tracked), found


def stereo_pairs(calibration: StereoCalibration, frame: StereoFrame, corners: Points) -> tuple[Points, Points]:
    """Corners of the left image that are also found in the right one, with their positions in both."""
    guess, shift = corners - disparity_guess(calibration, corners).astype(np.float32), right_shift(frame)
    right, found = track(frame.left, frame.right, corners, displaced(calibration, corners, guess, shift), LEVELS)
    kept = found & same_row(corners, as_calibrated(calibration, corners, right, shift))
    return corners[kept], right[kept]


def same_row(left: Points, right: Points) -> NDArray[np.bool_]:
    """Mask (n,) of pairs on one epipolar line, with a disparity that places them in front of the cameras."""
    difference = left - right
    one_row: NDArray[np.bool_] = (np.abs(difference[:, 1]) < _EPIPOLAR) & (difference[:, 0] > _LEAST_DISPARITY)
    return one_row


def disparity_guess(calibration: StereoCalibration, corners: Points) -> FloatArray:
    """Predicted shift (n, 2) [px] from left to right of corners, on level ground or on nearer scenery."""
    towards_ground = -rays_through(calibration, corners) @ calibration.X_SC[2, :3]  # per unit of depth
    inverse_depth = np.maximum(towards_ground / calibration.X_SC[2, 3], 1.0 / _SCENERY_DEPTH)
    shift = calibration.focal_length * calibration.baseline * inverse_depth
    return np.column_stack([shift, np.zeros(len(shift))])


class Matches(NamedTuple):
    """Images z = (u left, v, u right) [px] of the same n points in the previous and the current pair."""

    previous: FloatArray  # (n, 3)
    current: FloatArray  # (n, 3)

    def tracks(self) -> NDArray[np.float32]:
        """Tracks (n, 4) of the left images, as of ``estimates.Motion``."""
        return np.column_stack([self.previous[:, :2], self.current[:, :2]]).astype(np.float32)


def match(
    calibration: StereoCalibration, previous: StereoFrame, corners: Points, current: StereoFrame, X_PC: FloatArray
) -> Matches:
    """Match corners of the previous left image through all four images, starting from the predicted motion ``X_PC``.

    The circle is previous left, current left, current right, previous right. It must end where the direct match from
    previous left to previous right lies.
    """
    left_P, right_P = stereo_pairs(calibration, previous, corners)
    z_P = _images(left_P, as_calibrated(calibration, left_P, right_P, right_shift(previous)))
    guess = moved(calibration, z_P, X_PC)
    left_C, found = track(previous.left, current.left, left_P, guess[:, :2], LEVELS)
    disparity = np.stack([guess[:, 0] - guess[:, 2], np.zeros(len(guess), np.float32)], axis=1)
    shift = right_shift(current)
    right_guess = displaced(calibration, left_C, left_C - disparity, shift)
    right_C, found_right = track(current.left, current.right, left_C, right_guess, LEVELS_NEAR)
    closed, found_again = track(current.right, previous.right, right_C, right_P, LEVELS_NEAR)
    straight_C = as_calibrated(calibration, left_C, right_C, shift)
    kept = found & found_right & found_again & same_row(left_C, straight_C)
    kept &= np.linalg.norm(closed - right_P, axis=1) < _CLOSURE
    return Matches(z_P[kept], _images(left_C, straight_C)[kept])


def moved(calibration: StereoCalibration, z_P: FloatArray, X_PC: FloatArray) -> NDArray[np.float32]:
    """Predict the images (n, 3) after the motion of points with images z_P (n, 3) before it."""
    p_C = (triangulate(calibration, z_P) - X_PC[:3, 3]) @ X_PC[:3, :3]
    p_C[:, 2] = np.maximum(p_C[:, 2], NEAREST)
    return project(calibration, p_C).astype(np.float32)


def _images(left: Points, right: Points) -> FloatArray:
    """Stereo images z (n, 3) of left and right points; v is the mean of both rows."""
    return np.column_stack([left[:, 0], 0.5 * (left[:, 1] + right[:, 1]), right[:, 0]]).astype(np.float64)
