"""Points of keyframes looked for in a new pair, where the predicted pose takes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.keyframes import FINEST, Keyframe
from estimators.local_planes import rays_through, warps
from estimators.pose import Sightings
from estimators.stereo_geometry import project
from estimators.warped_matching import MARGIN, Float32Array, Found, find, templates, warped_patches
from sensors.messages import StereoFrame
from sensors.rig import StereoCalibration
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

    feature: NDArray[np.intp]  # (n,)
    X_NK: FloatArray  # (4, 4)
    z: FloatArray  # (n, 3) predicted images [px]
    patches: tuple[Float32Array, Float32Array]  # as the left and the right image should show them


def tracked(
    calibration: StereoCalibration, keyframes: Sequence[Keyframe], frame: StereoFrame, X_OC: FloatArray
) -> Tracks:
    """Points of the keyframes (newest first), looked for in the frame at the predicted pose ``X_OC``."""
    offers = _offers(calibration, keyframes, X_OC)
    z = np.concatenate([offer.z for offer in offers])
    left_image, right_image = frame.left.astype(np.float32), frame.right.astype(np.float32)
    left_patches, right_patches = (np.concatenate([offer.patches[side] for offer in offers]) for side in (0, 1))
    left = find(templates(left_patches), left_image, z[:, :2])
    shift = left.points - z[:, :2]
    right = find(templates(right_patches), right_image, np.column_stack([z[:, 2], z[:, 1]]) + shift)
    found = (left.likeness > _LIKENESS) & (right.likeness > _LIKENESS) & (np.abs(shift).max(axis=1) < _GATE)
    apart = left.points - right.points
    found &= (np.abs(apart[:, 1]) < _SAME_ROW) & (apart[:, 0] > _LEAST_DISPARITY)
    return Tracks(
        keyframe=np.repeat(np.arange(len(offers)), [len(offer.feature) for offer in offers]),
        feature=np.concatenate([offer.feature for offer in offers]),
        seen=_sightings(keyframes, offers, left, right),
        found=found,
    )


def _offers(calibration: StereoCalibration, keyframes: Sequence[Keyframe], X_OC: FloatArray) -> list[_Offer]:
    """Points of every keyframe that the pair should show; what older ones have not got, the newest fills up."""
    X_ON = keyframes[0].X_OK
    older_share = int(_OLDER * OFFERED / max(len(keyframes) - 1, 1))
    offers, left_over = [], OFFERED
    for keyframe in reversed(keyframes):
        limit = left_over if keyframe is keyframes[0] else older_share
        offers.append(_offer(calibration, keyframe, X_ON, X_OC, limit))
        left_over -= len(offers[-1].feature)
    return offers[::-1]


def _offer(
    calibration: StereoCalibration, keyframe: Keyframe, X_ON: FloatArray, X_OC: FloatArray, limit: int
) -> _Offer:
    X_CK = inverse(X_OC) @ keyframe.X_OK
    R, t = X_CK[:3, :3], X_CK[:3, 3]
    seen = keyframe.points @ R.T + t
    z = project(calibration, seen)
    inside = (z[:, :2] > MARGIN).all(axis=1) & (z[:, 2] > MARGIN) & (z[:, 0] < calibration.width - 1 - MARGIN)
    inside &= (z[:, 1] < calibration.height - 1 - MARGIN) & (seen[:, 2] > _NEAREST) & (keyframe.misses < _MISSES)
    feature = np.flatnonzero(inside)[:limit]
    centres, planes = keyframe.centres[feature], keyframe.planes[feature]
    rays = rays_through(calibration, centres)
    patches = tuple(
        warped_patches(keyframe.image, centres, warps(R, t - side, planes, rays))
        for side in (np.zeros(3), calibration.X_ClCr[:3, 3])
    )
    return _Offer(feature, inverse(X_ON) @ keyframe.X_OK, z[feature].astype(np.float32), (patches[0], patches[1]))


def _sightings(keyframes: Sequence[Keyframe], offers: Sequence[_Offer], left: Found, right: Found) -> Sightings:
    """The points in the axes of the newest keyframe, with their measured images."""
    points, covariance = [], []
    for keyframe, offer in zip(keyframes, offers, strict=True):
        R, p = offer.X_NK[:3, :3], offer.X_NK[:3, 3]
        points.append(keyframe.points[offer.feature] @ R.T + p)
        covariance.append(R @ keyframe.covariance[offer.feature] @ R.T)
    z = np.column_stack([left.points[:, 0], 0.5 * (left.points[:, 1] + right.points[:, 1]), right.points[:, 0]])
    v = 0.25 * (left.variance[:, 1] + right.variance[:, 1]) + 0.5 * FINEST**2
    variance = np.column_stack([left.variance[:, 0] + FINEST**2, v, right.variance[:, 0] + FINEST**2])
    return Sightings(
        np.concatenate(points), np.concatenate(covariance), z.astype(np.float64), variance.astype(np.float64)
    )
