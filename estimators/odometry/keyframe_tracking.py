"""Keyframes of a stereo odometry, and the pose of a new pair that tracks their points."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.exposure import clipped_share, match_clipping
from estimators.odometry.image_points import (
    LEVELS_NEAR,
    detect_corners,
    local_planes,
    rays_through,
    stereo_pairs,
    track,
    warps,
)
from estimators.odometry.pose import Observations, consensus, point_covariance, refined
from estimators.odometry.warped_matching import MARGIN, Float32Array, PatchMatches, match_patches
from estimators.rigid_motion import UncertainMotion
from estimators.stereo_pair import Points, as_calibrated, image_shift, project, right_position, right_shift, triangulate
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, inverse

_PER_BUCKET = 4  # corners; bare ground fills at most half of the buckets
_CLOSURE = 0.6  # largest distance between start and end of the track from left to right and back [px]
_LEAST_STEREO_CORRELATION = 0.8  # least normalised correlation of left and right patch
_MOVED = 2.5  # largest distance of the warped match from the tracked point [px]
_SAME_STEREO_ROW = 1.0  # largest difference of the rows in left and right [px]
FINEST = 0.03  # least error of a patch in a later frame: sampling and interpolation, on rendered frames [px]
_FINEST_STEREO = 0.06  # the same in the right image: a patch is not exactly a plane; measured likewise [px]
_OWN = 0.02  # error in the keyframe's left image, which defines its points: sampling alone [px]


class Keyframe(NamedTuple):
    """A view with n points in random order, so that the first few are a fair and repeatable sample."""

    tick: int
    X_OK: FloatArray  # (4, 4) pose of the left camera in O, the frame in which the odometry started
    image: GreyImage  # left
    clipped: float  # share of its pixels
    centres: Points  # (n, 2) of the points' patches [px]
    points: FloatArray  # (n, 3) in K [m]
    covariance: FloatArray  # (n, 3, 3) of the points [m2]
    planes: FloatArray  # (n, 3) around the points: n . X = 1 [1/m]
    misses: NDArray[np.int64]  # (n,) consecutive frames in which the point was not found where predicted


def new_keyframe(
    calibration: StereoCalibration, frame: StereoFrame, X_OK: FloatArray, rng: np.random.Generator
) -> Keyframe:
    """Keyframe from a frame at pose ``X_OK``."""
    left, right = stereo_pairs(calibration, frame, detect_corners(frame.left, per_bucket=_PER_BUCKET))
    back, found = track(frame.right, frame.left, right, left, LEVELS_NEAR)
    closed = found & (np.abs(back - left).max(axis=1, initial=0.0) < _CLOSURE)
    left, right, shift = left[closed], right[closed], right_shift(frame)
    disparity = left[:, 0] - as_calibrated(calibration, left, right, shift)[:, 0]
    planes = local_planes(calibration, left, disparity.astype(np.float64), rng)
    bent = warps(np.eye(3), -right_position(calibration, shift), planes, rays_through(calibration, left))
    matched = match_patches([(frame.left, len(left))], left, bent, frame.right, right)
    straight = as_calibrated(calibration, left, matched.points, shift)
    apart = left - straight
    kept = (
        (matched.correlation > _LEAST_STEREO_CORRELATION)
        & (np.abs(apart[:, 1]) < _SAME_STEREO_ROW)
        & (apart[:, 0] > 0.0)
    )
    kept &= np.abs(matched.points - right).max(axis=1, initial=0.0) < _MOVED
    chosen = rng.permutation(np.flatnonzero(kept))
    z = np.column_stack([left[:, 0], 0.5 * (left[:, 1] + straight[:, 1]), straight[:, 0]]).astype(np.float64)
    u, v = (matched.variance + _FINEST_STEREO**2).T
    points = triangulate(calibration, z[chosen])
    variance = np.column_stack([np.full(len(u), _OWN**2), 0.5 * v, u])[chosen]
    return Keyframe(
        tick=frame.tick,
        X_OK=X_OK,
        image=frame.left,
        clipped=clipped_share(frame.left),
        centres=left[chosen],
        points=points,
        covariance=point_covariance(calibration, points, variance),
        planes=planes[chosen],
        misses=np.zeros(len(chosen), np.int64),
    )


_FEWEST_INLIERS = 25  # fewer may agree by chance
_TRACKED = 0.3  # least share of tracked points; with fewer the prediction is wrong or the view has changed
MOST_POINTS = 420  # to search for; more cost time and bring little, as errors of neighbours are correlated
_OLDER = 0.55  # share of them from older keyframes: old points limit the drift, new ones match best
_LEAST_CORRELATION = 0.75  # least normalised correlation of a match
_SAME_ROW = 1.2  # largest difference of the rows in left and right: matching error and 0.1 deg of mis-rotation [px]
_NEAREST = 1.0  # [m]
_LEAST_DISPARITY = 0.4  # [px]
_CLIPPED = 0.02  # share of an image below which clipping has no effect on the motion
_MISSES = 2  # consecutive misses after which a point is dropped: it is hidden or on a moving object


class Tracks(NamedTuple):
    """Points of the keyframes with their images in the new pair."""

    keyframe: NDArray[np.intp]  # (n,) index of the point's keyframe, newest first
    feature: NDArray[np.intp]  # (n,) index of the point in it
    observations: Observations  # of all n points, in the axes of the newest keyframe N
    found: NDArray[np.bool_]  # (n,)
    pairs: NDArray[np.float32]  # (n, 4) u, v in the left and u, v in the right image [px]


class _Candidates(NamedTuple):
    """Points of one keyframe that are searched for."""

    keyframe: Keyframe
    feature: NDArray[np.intp]  # (n,)
    z: Float32Array  # (n, 3) predicted images [px]


def tracked(
    calibration: StereoCalibration, keyframes: Sequence[Keyframe], frame: StereoFrame, X_OC: FloatArray
) -> Tracks:
    """Track points of the keyframes (newest first) in the frame at the predicted pose ``X_OC``."""
    X_CK = inverse(X_OC) @ np.array([keyframe.X_OK for keyframe in keyframes])
    candidates = _candidates(calibration, keyframes, X_CK)
    number = np.repeat(np.arange(len(candidates)), [len(candidate.feature) for candidate in candidates])
    z = np.concatenate([candidate.z for candidate in candidates])
    displacement = _displacement(calibration, candidates, X_CK, right_shift(frame))
    left, right = _matched(calibration, candidates, frame, X_CK, z, displacement)
    clipped = clipped_share(frame.left)
    for k, candidate in enumerate(candidates):
        if max(candidate.keyframe.clipped, clipped) < _CLIPPED:
            continue
        of_this, keyframe = number == k, candidate.keyframe
        tracks = np.hstack([keyframe.centres[candidate.feature], left.points[of_this]])
        limited = match_clipping(keyframe.image, frame, tracks)
        if limited is not None:  # both are clipped where one of them is
            as_clipped = candidate._replace(keyframe=keyframe._replace(image=limited[0]))
            again = _matched(calibration, [as_clipped], limited[1], X_CK[k : k + 1], z[of_this], displacement[of_this])
            for matches, of_one in zip((left, right), again, strict=True):
                for values, changed in zip(matches, of_one, strict=True):
                    values[of_this] = changed
    pairs = np.hstack([left.points, right.points])
    right = right._replace(points=right.points - displacement)
    found = np.minimum(left.correlation, right.correlation) > _LEAST_CORRELATION
    apart = left.points - right.points
    found &= (np.abs(apart[:, 1]) < _SAME_ROW) & (apart[:, 0] > _LEAST_DISPARITY)
    return Tracks(
        keyframe=number,
        feature=np.concatenate([candidate.feature for candidate in candidates]),
        observations=_observations(candidates, left, right),
        found=found,
        pairs=pairs,
    )


def _matched(
    calibration: StereoCalibration,
    candidates: Sequence[_Candidates],
    frame: StereoFrame,
    X_CK: FloatArray,
    z: Float32Array,
    displacement: Float32Array,
) -> tuple[PatchMatches, PatchMatches]:
    """Matches in the left and right image of all points, near their predicted images ``z`` (n, 3).

    In the right image they are moved by ``displacement`` (n, 2).
    """
    sources = [(candidate.keyframe.image, len(candidate.feature)) for candidate in candidates]
    centres = np.concatenate([candidate.keyframe.centres[candidate.feature] for candidate in candidates])
    planes = np.concatenate([candidate.keyframe.planes[candidate.feature] for candidate in candidates])
    of_points = np.repeat(X_CK, [len(candidate.feature) for candidate in candidates], axis=0)
    t_left = of_points[:, :3, 3]
    t_sides = np.stack([t_left, t_left - right_position(calibration, right_shift(frame))])
    to_left, to_right = warps(of_points[:, :3, :3], t_sides, planes, rays_through(calibration, centres))
    left = match_patches(sources, centres, to_left, frame.left, z[:, :2])
    guess = z[:, [2, 1]] + left.points - z[:, :2] + displacement
    return left, match_patches(sources, centres, to_right, frame.right, guess)


def _candidates(calibration: StereoCalibration, keyframes: Sequence[Keyframe], X_CK: FloatArray) -> list[_Candidates]:
    """Visible points of every keyframe; the newest fills up the share that older ones leave."""
    of_each = [X[:3, :3] @ keyframe.points.T + X[:3, 3:] for keyframe, X in zip(keyframes, X_CK, strict=True)]
    points, misses = np.concatenate(of_each, axis=1).T, np.concatenate([keyframe.misses for keyframe in keyframes])
    z = project(calibration, points)
    u, v, u_right = z.T
    inside = (u > MARGIN) & (v > MARGIN) & (u_right > MARGIN) & (u < calibration.width - 1 - MARGIN)
    inside &= (v < calibration.height - 1 - MARGIN) & (points[:, 2] > _NEAREST) & (misses < _MISSES)
    older_share = int(_OLDER * MOST_POINTS / max(len(keyframes) - 1, 1))
    candidates, remaining, end = [], MOST_POINTS, len(points)
    for keyframe in reversed(keyframes):
        limit = remaining if keyframe is keyframes[0] else older_share
        start = end - len(keyframe.points)
        feature = np.flatnonzero(inside[start:end])[:limit]
        candidates.append(_Candidates(keyframe, feature, z[start + feature].astype(np.float32)))
        remaining, end = remaining - len(feature), start
    return candidates[::-1]


def _displacement(
    calibration: StereoCalibration, candidates: Sequence[_Candidates], X_CK: FloatArray, shift: FloatArray | None
) -> Float32Array:
    """Image shifts (n, 2) of the points by the displacement of the right camera [px]; the points are near X_CK."""
    if shift is None:
        return np.zeros((sum(len(candidate.feature) for candidate in candidates), 2), np.float32)
    points = [c.keyframe.points[c.feature] @ X[:3, :3].T + X[:3, 3] for c, X in zip(candidates, X_CK, strict=True)]
    return np.asarray(image_shift(calibration, np.concatenate(points), shift), dtype=np.float32)


def _observations(candidates: Sequence[_Candidates], left: PatchMatches, right: PatchMatches) -> Observations:
    """Points in the axes of the newest keyframe with their measured images."""
    X_NK = inverse(candidates[0].keyframe.X_OK) @ np.array([candidate.keyframe.X_OK for candidate in candidates])
    R = X_NK[:, :3, :3]
    twice = np.einsum("nij,nkl->njlik", R, R).reshape(-1, 9, 9)  # R C R' of C as a row
    points, covariance = [], []
    for k, (keyframe, feature, _) in enumerate(candidates):
        points.append(keyframe.points[feature] @ R[k].T + X_NK[k, :3, 3])
        covariance.append(keyframe.covariance[feature].reshape(-1, 9) @ twice[k])
    z = np.column_stack([left.points[:, 0], 0.5 * (left.points[:, 1] + right.points[:, 1]), right.points[:, 0]])
    v = 0.25 * (left.variance[:, 1] + right.variance[:, 1]) + 0.5 * FINEST**2
    variance = np.column_stack([left.variance[:, 0] + FINEST**2, v, right.variance[:, 0] + FINEST**2])
    return Observations(
        np.concatenate(points),
        np.concatenate(covariance).reshape(-1, 3, 3),
        z.astype(np.float64),
        variance.astype(np.float64),
    )


class Located(NamedTuple):
    """Pose of the pair, measured from the newest keyframe N."""

    measured: UncertainMotion  # X_NC, covariance along the axes of N
    own: FloatArray  # (6, 6) part of the covariance that comes from this pair, not from the keyframes
    tracks: Tracks
    agreeing: NDArray[np.bool_]  # (n,) inliers of the pose
    differences: FloatArray  # (3, 6) between halves of the points, as in ``self_consistency``


def located(
    calibration: StereoCalibration,
    keyframes: Sequence[Keyframe],
    frame: StereoFrame,
    X_OC: FloatArray,
    reach: float,
    rng: np.random.Generator,
) -> Located | None:
    """Pose within ``reach`` [m] of the predicted ``X_OC``; None if too few points agree."""
    tracks = tracked(calibration, keyframes, frame, X_OC)
    needed = max(_FEWEST_INLIERS, int(_TRACKED * len(tracks.found)))
    found = np.flatnonzero(tracks.found)
    if len(found) < needed:
        return None
    observed = Observations(*(of_all[found] for of_all in tracks.observations))
    agreed = consensus(calibration, observed.points, observed.z, inverse(keyframes[0].X_OK) @ X_OC, reach, rng)
    if np.count_nonzero(agreed.inliers) < needed:
        return None
    solution = refined(calibration, observed, agreed.X_PC, agreed.inliers, tracks.keyframe[found] == 0)
    if not solution.converged or np.count_nonzero(solution.inliers) < needed:
        return None
    agreeing = np.zeros(len(tracks.found), np.bool_)
    agreeing[found[solution.inliers]] = True
    measured = UncertainMotion(solution.X_PC, solution.covariance)
    return Located(measured, solution.own, tracks, agreeing, solution.differences)
