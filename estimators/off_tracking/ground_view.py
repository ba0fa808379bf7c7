"""Views of the ground: features with their positions on it, and the planar motion between two views.

FAST corners, as in Miao's system, with SIFT descriptors. Miao's SURF is patented and not part of OpenCV's main modules;
SIFT is the descriptor that SURF approximates, its patent has expired, and it takes 7 ms for 300 corners at one scale.
The cameras keep their height, so one scale is enough. The trailer's yaw is known to a few degrees from its own motion,
so descriptors are aligned with the ground instead of the dominant gradient.

A camera tilted against the ground distorts it by perspective: a point at r from the centre of the view appears at
r + r (k . r), with k the tilt over the height. Between two views at a distance d this acts as the shear d k^T. A fit
without k takes half of it for a rotation: 0.07 deg of roll at 1 m of height cause 1 deg over 14 m. So k [1/m] is
estimated with every motion.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.odometry.image_points import rays_through, strongest_in_buckets
from estimators.rigid_motion import UncertainMotion, spatial_covariance
from estimators.stereo_pair import project
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage
from vehicle.frames import FloatArray, so3_exp

_THRESHOLDS = (20, 8)  # of FAST [grey levels]; the second one for ground with little texture
_ENOUGH = 600  # corners at the first threshold; with fewer the second one is used
_BUCKET = 60  # [px]
_PER_BUCKET = 5  # 320 corners in an image of 480x480 px
_SIZE = 5.0  # size of a keypoint, in SIFT's units; larger ones match no better and take longer [px]
_BORDER = 12  # half of the descriptor's patch [px]
_REFINE = (3, 3)  # half window of the sub-pixel refinement [px]
_REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 10, 0.02)
_FARTHEST = 1.5  # largest refinement; beyond it another corner was found [px]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundView:
    """Features of one image."""

    positions: FloatArray  # (n, 2) on the ground, in the trailer frame S at capture [m]
    descriptors: NDArray[np.float32]  # (n, 128), aligned with the ground


class GroundCamera(NamedTuple):
    """A pinhole over level ground."""

    pinhole: StereoCalibration
    X_SC: FloatArray  # (4, 4)

    def on_ground(self, pixels: FloatArray) -> FloatArray:
        """Intersections (n, 2) of the rays through pixels (n, 2) with the ground z = 0, in S [m]."""
        along = rays_through(self.pinhole, pixels) @ self.X_SC[:3, :3].T
        reach = -self.X_SC[2, 3] / along[:, 2]
        return np.asarray(self.X_SC[:2, 3] + reach[:, None] * along[:, :2], dtype=np.float64)

    def in_image(self, positions: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 2) on the ground."""
        from_camera = np.column_stack([positions, np.zeros(len(positions))]) - self.X_SC[:3, 3]
        return project(self.pinhole, from_camera @ self.X_SC[:3, :3])[:, :2]


def ground_cameras(calibration: StereoCalibration) -> tuple[GroundCamera, GroundCamera]:
    """Front (left) and rear (right) camera of a pair under the trailer.

    Raises:
        ValueError: if they do not look down at the ground.
    """
    height, down = float(calibration.X_SC[2, 3]), float(-calibration.X_SC[2, 2])
    if not (height > 0.0 and down > math.cos(math.radians(20.0))):  # beyond it the image's edge nears the horizon
        raise ValueError(
            f"cameras {height} m above the ground, {math.degrees(math.acos(down)):.0f} deg off the vertical: "
            "ground-watching needs cameras above the ground that look down within 20 deg"
        )
    X_SC = calibration.X_SC
    return GroundCamera(calibration, X_SC), GroundCamera(calibration, X_SC @ calibration.X_ClCr)


def viewed(camera: GroundCamera, image: GreyImage, heading: float) -> GroundView:
    """Features of an image taken at about the yaw ``heading`` [rad] of the trailer since the start."""
    pixels = _refined(image, _corners(image))
    angle = math.degrees(heading) % 360.0  # the ground turns to the right seen from above, and mirrored in the image
    keypoints = [cv2.KeyPoint(float(u), float(v), _SIZE, angle) for u, v in pixels]
    if not keypoints:
        return GroundView(positions=np.empty((0, 2)), descriptors=np.empty((0, 128), np.float32))
    described, descriptors = cv2.SIFT.create().compute(image, keypoints)
    kept = np.array([keypoint.pt for keypoint in described], dtype=np.float64)
    return GroundView(positions=camera.on_ground(kept), descriptors=np.asarray(descriptors, dtype=np.float32))


def _corners(image: GreyImage) -> NDArray[np.float32]:
    """The strongest FAST corners of each bucket (n, 2)."""
    for threshold in _THRESHOLDS:
        corners = cv2.FastFeatureDetector.create(threshold).detect(image)
        if len(corners) >= _ENOUGH:
            break
    points = np.array([corner.pt for corner in corners], dtype=np.float32).reshape(-1, 2)
    strength = np.array([corner.response for corner in corners], dtype=np.float32)
    last = np.array(image.shape[::-1]) - 1 - _BORDER
    inside = ((points >= _BORDER) & (points <= last)).all(axis=1)
    points, strength = points[inside], strength[inside]
    return points[strongest_in_buckets(points, strength, _PER_BUCKET, _BUCKET)]


def _refined(image: GreyImage, corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Corners refined to a fraction of a pixel."""
    if len(corners) == 0:
        return corners
    refined = cv2.cornerSubPix(image, corners.copy(), _REFINE, (-1, -1), _REFINED)
    close = np.abs(refined - corners).max(axis=1) < _FARTHEST
    return np.where(close[:, None], refined, corners)


_ITERATIONS = 2  # from the rigid fit, which has an error of 0.1 %
_TILT = 0.03  # k at a roll of 2 deg with cameras 1 m above the ground, 1 sigma [1/m]
_NOISE = 1e-3  # error of a point on the ground, half a pixel; weight of that prior [m]
_FRAME_CORRELATION = 2.0  # factor for correlated errors of neighbours: the normalised error of motions is then about 1
_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # rotation by +90 deg
_RATIO = 0.8  # largest distance of a match relative to the second best (Lowe 2004)
_GATE = 0.008  # largest error of an inlier of the homography: three pixels of a camera 1 m above the ground [m]
_FEWEST = 20  # inliers of a valid homography; fewer may agree by chance
_SHARE = 0.25  # least share of inliers if both views show the same ground
_CORRELATION = 2.0  # factor for correlated errors of neighbours and the neglected tilt: measured
FINEST = 1e-4  # least error of a match [m]
UPRIGHT = 1e-12  # variance of roll, pitch and height, which a planar motion keeps [rad2, m2]


class Pairs(NamedTuple):
    """Positions (n, 2) of the same features in two trailer frames [m]."""

    first: FloatArray
    second: FloatArray
    matches: int  # number of matches before RANSAC

    @property
    def enough(self) -> bool:
        """True if there are enough inliers for two views of the same ground."""
        return len(self.first) >= max(_FEWEST, _SHARE * self.matches)


def paired(first: GroundView, second: GroundView) -> Pairs:
    """Matched features of two views that agree with one homography."""
    if min(len(first.positions), len(second.positions)) < 2:
        return Pairs(first.positions[:0], second.positions[:0], 0)
    # exact search: for 400 features a tree is no faster, and its random numbers cannot be seeded
    neighbours = cv2.BFMatcher.create(cv2.NORM_L2).knnMatch(first.descriptors, second.descriptors, k=2)
    good = [best for best, next_best in neighbours if best.distance < _RATIO * next_best.distance]
    p = first.positions[np.array([match.queryIdx for match in good], dtype=np.intp)]
    q = second.positions[np.array([match.trainIdx for match in good], dtype=np.intp)]
    if len(p) < _FEWEST:
        return Pairs(p[:0], q[:0], len(p))
    homography, inliers = cv2.findHomography(p - p.mean(axis=0), q - q.mean(axis=0), cv2.RANSAC, _GATE)
    if homography is None:
        return Pairs(p[:0], q[:0], len(p))
    agreeing = inliers.ravel() > 0
    return Pairs(p[agreeing], q[agreeing], len(p))


def planar_motion(pairs: Pairs) -> UncertainMotion:
    """X_FS (4, 4) of the second trailer frame in the first: least-squares rotation and translation by SVD."""
    p, q = pairs.first, pairs.second
    p_mean, q_mean = p.mean(axis=0), q.mean(axis=0)
    U, _, Vt = np.linalg.svd((p - p_mean).T @ (q - q_mean))
    R = U @ np.diag([1.0, np.linalg.det(U @ Vt)]) @ Vt
    X = np.eye(4)
    X[:2, :2], X[:2, 3] = R, p_mean - R @ q_mean
    turned = q @ R.T
    residual, A = p - p_mean - (turned - turned.mean(axis=0)), _by_motion(turned).reshape(-1, 3)
    variance = _CORRELATION**2 * (FINEST**2 + float(np.square(residual).sum()) / max(1, 2 * len(p) - 3))
    planar = np.asarray(variance * np.linalg.inv(A.T @ A), dtype=np.float64)
    return UncertainMotion(X, spatial_covariance(planar, UPRIGHT * np.eye(6)))


def _by_motion(turned: FloatArray) -> FloatArray:
    """Derivatives (n, 2, 3) of points (n, 2) by rotation and translation of their frame."""
    return np.dstack([turned @ _TURN.T, np.tile([1.0, 0.0], (len(turned), 1)), np.tile([0.0, 1.0], (len(turned), 1))])


def ground_motion(views: Sequence[tuple[Pairs, FloatArray]]) -> tuple[UncertainMotion, float]:
    """Least-squares motion X_PC for the pairs of each camera, given with the centre (2,) of its view in S [m].

    The second value is the difference of the cameras' mean residuals [m], which the covariance contains.
    """
    p, q = (np.concatenate([pairs[i] for pairs, _ in views]) for i in range(2))
    middles = np.concatenate([np.broadcast_to(middle, pairs.first.shape) for pairs, middle in views])
    X = planar_motion(Pairs(p, q, sum(pairs.matches for pairs, _ in views))).X
    R, t, k = X[:2, :2].copy(), X[:2, 3].copy(), np.zeros(2)
    for _ in range(_ITERATIONS):
        turned = q @ R.T
        from_middle, then = p - middles, (q - middles) @ R.T
        slant = from_middle[:, :, None] * from_middle[:, None]  # times k: shift by the tilt
        slant -= then[:, :, None] * (q - middles)[:, None]
        residual = p - turned - t - slant @ k
        A = np.concatenate([_by_motion(turned), slant], axis=2).reshape(-1, 5)
        normal = A.T @ A + np.diag([0.0, 0.0, 0.0, 1.0, 1.0]) * (_NOISE / _TILT) ** 2
        prior = np.concatenate([np.zeros(3), k]) * (_NOISE / _TILT) ** 2
        step = np.linalg.solve(normal, A.T @ residual.ravel() - prior)
        R, t, k = so3_exp(np.array([0.0, 0.0, step[0]]))[:2, :2] @ R, t + step[1:3], k + step[3:]
    ends = np.cumsum([0, *(len(pairs.first) for pairs, _ in views)]).tolist()
    means = [residual[start:end].mean(axis=0) for start, end in pairwise(ends)]  # of each camera
    disagreement = float(np.linalg.norm(means[0] - means[-1]))
    X[:2, :2], X[:2, 3] = R, t
    variance = _FRAME_CORRELATION**2 * (FINEST**2 + float(np.square(residual).sum()) / (2 * len(residual) - 5))
    planar = variance * np.linalg.inv(normal)[:3, :3] + disagreement**2 * np.diag([0.0, 1.0, 1.0])
    return UncertainMotion(X, spatial_covariance(planar, UPRIGHT * np.eye(6))), disagreement
