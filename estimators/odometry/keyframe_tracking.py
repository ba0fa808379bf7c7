"""Points of keyframes looked for in a new pair, where the predicted pose takes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.odometry.keyframes import FINEST, Keyframe
from estimators.odometry.local_planes import rays_through, warps
from estimators.odometry.pose import Sightings
from estimators.odometry.warped_matching import MARGIN, Float32Array, Found, find, sampled, templates, warped_places
from estimators.stereo_geometry import project
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray, inverse

OFFERED = 420  # points to look for; more cost time and bring little: errors of neighbours are alike
_OLDER = 0.55  # share of them from older keyframes: these hold the pose against drift, new ones match best
_LIKENESS = 0.75  # least normalised correlation of a match
_GATE = 8.0  # a match may lie so far from where it was predicted [px]
_SAME_ROW = 1.2  # rows in left and right may differ by this: matching error and 0.1 deg of mis-rotation [px]
_NEAREST = 1.0  # [m]
_LEAST_DISPARITY = 0.4  # [px]
_MISSES = 2  # a point not seen where it should be, so often in a row, stands on something that moves or hides it


class Tracks(NamedTuple):
    """Points of the keyframes and where the new pair shows them."""

    keyframe: NDArray[np.intp]  # (n,) which keyframe a point is of, newest first
    feature: NDArray[np.intp]  # (n,) its number there
    seen: Sightings  # of all n points, given in the newest keyframe N
    found: NDArray[np.bool_]  # (n,)


class _Offer(NamedTuple):
    """What is looked for of one keyframe."""

    keyframe: Keyframe
    feature: NDArray[np.intp]  # (n,)
    z: Float32Array  # (n, 3) predicted images [px]


def tracked(
    calibration: StereoCalibration, keyframes: Sequence[Keyframe], frame: StereoFrame, X_OC: FloatArray
) -> Tracks:
    """Points of the keyframes (newest first), looked for in the frame at the predicted pose ``X_OC``."""
    X_CK = inverse(X_OC) @ np.array([keyframe.X_OK for keyframe in keyframes])
    offers = _offers(calibration, keyframes, X_CK)
    number = np.repeat(np.arange(len(offers)), [len(offer.feature) for offer in offers])
    z = np.concatenate([offer.z for offer in offers])
    left_patches, right_patches = _patches(calibration, offers, X_CK[number])
    left = find(templates(left_patches), frame.left.astype(np.float32), z[:, :2])
    shift = left.points - z[:, :2]
    right = find(templates(right_patches), frame.right.astype(np.float32), z[:, [2, 1]] + shift)
    found = (left.likeness > _LIKENESS) & (right.likeness > _LIKENESS) & (np.abs(shift).max(axis=1) < _GATE)
    apart = left.points - right.points
    found &= (np.abs(apart[:, 1]) < _SAME_ROW) & (apart[:, 0] > _LEAST_DISPARITY)
    return Tracks(
        keyframe=number,
        feature=np.concatenate([offer.feature for offer in offers]),
        seen=_sightings(offers, number, left, right),
        found=found,
    )


def _offers(calibration: StereoCalibration, keyframes: Sequence[Keyframe], X_CK: FloatArray) -> list[_Offer]:
    """Points of every keyframe that the pair should show; what older ones have not got, the newest fills up."""
    of_each = [keyframe.points @ X[:3, :3].T + X[:3, 3] for keyframe, X in zip(keyframes, X_CK, strict=True)]
    points, misses = np.concatenate(of_each), np.concatenate([keyframe.misses for keyframe in keyframes])
    z = project(calibration, points)
    u, v, u_right = z.T
    inside = (u > MARGIN) & (v > MARGIN) & (u_right > MARGIN) & (u < calibration.width - 1 - MARGIN)
    inside &= (v < calibration.height - 1 - MARGIN) & (points[:, 2] > _NEAREST) & (misses < _MISSES)
    older_share = int(_OLDER * OFFERED / max(len(keyframes) - 1, 1))
    offers, left_over, end = [], OFFERED, len(points)
    for keyframe in reversed(keyframes):
        limit = left_over if keyframe is keyframes[0] else older_share
        start = end - len(keyframe.points)
        feature = np.flatnonzero(inside[start:end])[:limit]
        offers.append(_Offer(keyframe, feature, z[start + feature].astype(np.float32)))
        left_over, end = left_over - len(feature), start
    return offers[::-1]


def _patches(
    calibration: StereoCalibration, offers: Sequence[_Offer], X_CK: FloatArray
) -> tuple[Float32Array, Float32Array]:
    """The patches (n, 289) as the left and the right image should show them, from poses (n, 4, 4)."""
    centres = np.concatenate([offer.keyframe.centres[offer.feature] for offer in offers])
    planes = np.concatenate([offer.keyframe.planes[offer.feature] for offer in offers])
    t_sides = np.stack([X_CK[:, :3, 3], X_CK[:, :3, 3] - calibration.X_ClCr[:3, 3]])
    bent = warps(X_CK[:, :3, :3], t_sides, planes, rays_through(calibration, centres))
    (u_left, u_right), (v_left, v_right) = warped_places(centres, bent)
    left, right, end = [], [], 0
    for offer in offers:  # both sides at once, while the image is in the cache
        image, part = offer.keyframe.image, slice(end, end + len(offer.feature))
        left.append(sampled(image, u_left[part], v_left[part]))
        right.append(sampled(image, u_right[part], v_right[part]))
        end = part.stop
    return np.concatenate(left), np.concatenate(right)


def _sightings(offers: Sequence[_Offer], number: NDArray[np.intp], left: Found, right: Found) -> Sightings:
    """The points in the axes of the newest keyframe, with their measured images."""
    X_NK = inverse(offers[0].keyframe.X_OK) @ np.array([offer.keyframe.X_OK for offer in offers])[number]
    R = np.ascontiguousarray(X_NK[:, :3, :3])
    points = np.concatenate([offer.keyframe.points[offer.feature] for offer in offers])
    covariance = np.concatenate([offer.keyframe.covariance[offer.feature] for offer in offers])
    z = np.column_stack([left.points[:, 0], 0.5 * (left.points[:, 1] + right.points[:, 1]), right.points[:, 0]])
    v = 0.25 * (left.variance[:, 1] + right.variance[:, 1]) + 0.5 * FINEST**2
    variance = np.column_stack([left.variance[:, 0] + FINEST**2, v, right.variance[:, 0] + FINEST**2])
    return Sightings(
        np.einsum("nij,nj->ni", R, points) + X_NK[:, :3, 3],
        R @ covariance @ R.transpose(0, 2, 1),
        z.astype(np.float64),
        variance.astype(np.float64),
    )
