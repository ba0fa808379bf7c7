"""Uncertain rigid motions: composition, change of the body-fixed frame, and scaling in time.

The covariance (6, 6) of a motion X_PC is that of (rotation vector [rad], translation [m]) along the axes of P:
the true rotation is ``so3_exp(d_theta) @ R_PC``, the true translation ``p_PC + d_p``. A part of these errors may be
alike in all motions of a camera: ``common`` (6, 13) times the same 13 standard normal numbers.
"""

import math
from typing import NamedTuple

import numpy as np

from vehicle.frames import FloatArray, inverse, orthonormalised, skew, so3_exp, transform


def nothing_common() -> FloatArray:
    """Common errors (6, 13) of a motion without any: six of features, seven of a calibration."""
    return np.zeros((6, 13))


def lasting(covariance: FloatArray, share: FloatArray | float) -> FloatArray:
    """Common errors (6, 13) of motions: a ``share`` of the standard deviations of a covariance (6, 6), one or six."""
    variances, axes = np.linalg.eigh(covariance)
    errors = np.diag(np.broadcast_to(share, 6)) @ (axes * np.sqrt(np.maximum(variances, 0.0))) @ axes.T
    return np.hstack([errors, np.zeros((6, 7))])


class UncertainMotion(NamedTuple):
    """A motion X_AB with the covariance of its error along the axes of A."""

    X: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6)
    common: FloatArray = nothing_common()  # (6, 13) part of the error that motions share


def chained(X_AB: FloatArray, X_BC: FloatArray) -> FloatArray:
    """X_AC = X_AB @ X_BC with its rotation projected back onto SO(3), so that long chains stay rotations."""
    X_AC = X_AB @ X_BC
    return transform(orthonormalised(X_AC[:3, :3]), X_AC[:3, 3])


def composed(first: UncertainMotion, second: UncertainMotion) -> UncertainMotion:
    """X_AC = X_AB @ X_BC for errors that are independent but for what they share."""
    p_BC_A = first.X[:3, :3] @ second.X[:3, 3]
    # p_AC = p_AB + R_AB p_BC, so d p_AC = d p_AB + d_theta_AB x (R_AB p_BC) + R_AB d p_BC
    J = np.eye(6)
    J[3:, :3] = -skew(p_BC_A)
    X_AC, covariance, common = continued(first.X, second)
    shared = J @ first.common @ common.T
    covariance = J @ first.covariance @ J.T + covariance + shared + shared.T
    return UncertainMotion(transform(orthonormalised(X_AC[:3, :3]), X_AC[:3, 3]), covariance, J @ first.common + common)


def continued(X_AB: FloatArray, motion: UncertainMotion) -> UncertainMotion:
    """X_AC = X_AB @ X_BC for an exact X_AB."""
    R = _for_both(X_AB[:3, :3])
    return UncertainMotion(X_AB @ motion.X, R @ motion.covariance @ R.T, R @ motion.common)


def along_axes(R_AB: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariance (6, 6) along the axes of A, from that along the axes of B."""
    R = _for_both(R_AB)
    return R @ covariance @ R.T


def _for_both(R: FloatArray) -> FloatArray:
    """R (3, 3) for rotation vector and translation, (6, 6)."""
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = R
    return both


def inverted(motion: UncertainMotion) -> UncertainMotion:
    """X_BA, with the covariance of its error along the axes of B."""
    R_BA, p_AB = motion.X[:3, :3].T, motion.X[:3, 3]
    # R_BA exp(-d_theta) and p_BA = -R_BA exp(-d_theta) (p_AB + d_p), so d p_BA = -R_BA (d_p + p_AB x d_theta)
    J = -_for_both(R_BA)
    J[3:, :3] = -R_BA @ skew(p_AB)
    return UncertainMotion(inverse(motion.X), J @ motion.covariance @ J.T, J @ motion.common)


def change_frame(X_SC: FloatArray, motion: UncertainMotion) -> UncertainMotion:
    """Motion of S from the motion of C, both fixed to the same rigid body with C at X_SC."""
    X = X_SC @ motion.X @ inverse(X_SC)
    R_SC, p_SC = X_SC[:3, :3], X_SC[:3, 3]
    # p = p_SC + R_SC p_C - R p_SC, so d p = R_SC d p_C - d_theta x (R p_SC), and d_theta = R_SC d_theta_C
    J = _for_both(R_SC)
    J[3:, :3] = skew(X[:3, :3] @ p_SC) @ R_SC
    return UncertainMotion(X, J @ motion.covariance @ J.T, J @ motion.common)


def stretched(X: FloatArray, ratio: float) -> FloatArray:
    """Motion at the same constant velocity over ``ratio`` times the duration of X (4, 4).

    The rotation scales. The chord scales and turns by half the extra rotation: exact to second order in the angle.
    """
    rotation = rotation_vector(X[:3, :3])
    chord = ratio * so3_exp(0.5 * (ratio - 1.0) * rotation) @ X[:3, 3]
    return transform(so3_exp(ratio * rotation), chord)


PLANAR = [2, 3, 4]  # places of yaw, x and y among the components of a motion


def planar_pose(X: FloatArray) -> FloatArray:
    """Yaw [rad], x and y [m] (3,) of a motion."""
    return np.array([rotation_vector(X[:3, :3])[2], X[0, 3], X[1, 3]])


def planar_covariance(covariance: FloatArray) -> FloatArray:
    """Covariance (3, 3) of yaw, x and y."""
    return covariance[np.ix_(PLANAR, PLANAR)]


def spatial_covariance(planar: FloatArray, rest: FloatArray) -> FloatArray:
    """Covariance (6, 6) with that of yaw, x and y (3, 3) in the place of their part of ``rest`` (6, 6)."""
    spatial = rest.copy()
    spatial[np.ix_(PLANAR, PLANAR)] = planar
    return spatial


def with_planar(X: FloatArray, pose: FloatArray) -> FloatArray:
    """The motion with another yaw [rad], x and y [m] (3,), and its own roll, pitch and height."""
    yaw, x, y = pose.tolist()
    R = so3_exp(np.array([0.0, 0.0, yaw - float(rotation_vector(X[:3, :3])[2])])) @ X[:3, :3]
    return transform(R, np.array([x, y, X[2, 3]]))


def rotation_vector(R: FloatArray) -> FloatArray:
    """Rotation vector (3,) [rad] of R (3, 3), for angles well below pi.

    OpenCV's Rodrigues rounds rotations below 1e-5 rad to zero; increments of an odometry are of that order.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    w = 0.5 * np.array([zy - yz, xz - zx, yx - xy])  # sin(angle) along the axis
    sine = math.sqrt(w @ w)
    angle = math.atan2(sine, 0.5 * (xx + yy + zz - 1.0))
    return w * (angle / sine if sine > 0.0 else 1.0)
