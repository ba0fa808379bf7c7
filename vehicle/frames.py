"""Frames, poses, angles and planar polylines, as every other module uses them.

All frames are right-handed. ``X_AB`` is the pose of frame B in frame A, ``p_AQ`` the position of Q from the
origin of A along the axes of A, ``R_AB`` a rotation; inner letters must cancel (``X_WC = X_WS @ X_SC``).

| frame          | origin                                | axes                                |
|----------------|---------------------------------------|-------------------------------------|
| W world        | start of the course                   | x first heading, y left, z up       |
| T tractor      | rear-axle centre, on the ground       | x forward, y left, z up (ISO 8855)  |
| S semitrailer  | hitch projected on the ground         | as T                                |
| C, Cl, Cr      | optical centre (C is the left camera) | x right, y down, z forward (OpenCV) |

Yaw, steer, curvature and articulation are positive to the left (about +z); pitch about +y (nose down), roll
about +x (left side up), as in ISO 8855.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Pose2(NamedTuple):
    """Planar pose X_AB of frame B in frame A."""

    x: float  # [m]
    y: float  # [m]
    psi: float  # yaw of B in A [rad]

    def __matmul__(self, other: "Pose2") -> "Pose2":
        """X_AC = X_AB @ X_BC."""
        c, s = math.cos(self.psi), math.sin(self.psi)
        return Pose2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap(self.psi + other.psi),
        )

    def inverse(self) -> "Pose2":
        """X_BA from X_AB."""
        c, s = math.cos(self.psi), math.sin(self.psi)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, -self.psi)

    def spatial(self) -> FloatArray:
        """The pose as a matrix (4, 4), on the ground without pitch and roll."""
        return transform(rotation_zyx(self.psi, 0.0, 0.0), np.array([self.x, self.y, 0.0]))

    def apply(self, points: FloatArray) -> FloatArray:
        """Points given in B, shape (n, 2), expressed in A."""
        c, s = math.cos(self.psi), math.sin(self.psi)
        transformed: FloatArray = points @ np.array((c, s, -s, c)).reshape(2, 2)
        transformed += np.array((self.x, self.y))
        return transformed


def wrap(angle: float) -> float:
    """The angle [rad] wrapped to (-pi, pi]."""
    wrapped = math.remainder(angle, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def limited_angle(angle: float, limit: float) -> float:
    """The angle [rad], limited to ``limit`` to either side."""
    return max(-limit, min(limit, angle))


def rotation_zyx(yaw: float, pitch: float, roll: float) -> FloatArray:
    """R_AB, shape (3, 3), of a body turned by yaw about z, then pitch about y, then roll about x [rad]."""
    cy, sy = math.cos(yaw), math.sin(yaw)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cr, sr = math.cos(roll), math.sin(roll)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a x b of two single vectors, (3,) each; faster than NumPy's, which checks their shapes."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a.tolist(), b.tolist()
    return np.array([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x])


def is_rotation(R: FloatArray, tolerance: float) -> bool:
    """True if a matrix (3, 3) of any numbers is orthonormal within a tolerance."""
    return bool(np.all(np.abs(R) <= 2.0) and np.allclose(R @ R.T, np.eye(3), atol=tolerance))


def transform(R: FloatArray, p: FloatArray) -> FloatArray:
    """Homogeneous pose X_AB, shape (4, 4), from R_AB (3, 3) and p_AB (3,)."""
    X = np.eye(4)
    X[:3, :3] = R
    X[:3, 3] = p
    return X


def raised(height: float) -> FloatArray:
    """X_AB of a frame B of equal axes whose origin lies ``height`` [m] above that of A, (4, 4)."""
    return transform(np.eye(3), np.array([0.0, 0.0, height]))


def inverse(X: FloatArray) -> FloatArray:
    """X_BA from X_AB, both (4, 4) and rigid."""
    R_t = X[:3, :3].T
    return transform(R_t, -R_t @ X[:3, 3])


def planar(X: FloatArray) -> Pose2:
    """The yaw-plane part of a rigid pose X_AB (4, 4): position x, y and the direction of B's x axis in A."""
    return Pose2(float(X[0, 3]), float(X[1, 3]), math.atan2(X[1, 0], X[0, 0]))


def skew(w: FloatArray) -> FloatArray:
    """Matrix (3, 3) with ``skew(w) @ a == cross(w, a)``."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def so3_exp(w: FloatArray) -> FloatArray:
    """Rotation matrix (3, 3) of the rotation vector w (3,) [rad] (Rodrigues' formula)."""
    angle = float(np.linalg.norm(w))
    K = skew(w)
    if angle < 1e-8:  # the series is exact to rounding here, and the quotient below is not
        return np.eye(3) + K + 0.5 * K @ K
    return np.eye(3) + (math.sin(angle) / angle) * K + ((1.0 - math.cos(angle)) / angle**2) * (K @ K)


def orthonormalised(R: FloatArray) -> FloatArray:
    """The rotation nearest to R (3, 3), as products of many rotations drift off SO(3)."""
    U, _, Vt = np.linalg.svd(R)
    nearest: FloatArray = U @ Vt
    return nearest


# Axes of a camera that looks along the body's +x: its x (right) is -y, its y (down) is -z, its z is +x.
R_BODY_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def quadrature(points: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights (points,) of the Gauss-Legendre rule on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    return 0.5 * (nodes + 1.0), 0.5 * weights


def arc_length(points: FloatArray) -> FloatArray:
    """Distance along the polyline through points (n, 2) from the first point to each of them [m], shape (n,)."""
    chords = points[1:] - points[:-1]
    along = np.zeros(len(chords) + 1)
    np.cumsum(np.hypot(chords[:, 0], chords[:, 1]), out=along[1:])
    return along


def resampled(points: FloatArray, stations: FloatArray) -> FloatArray:
    """Points (m, 2) at distances ``stations`` (m,) along the polyline through points (n, 2) [m]."""
    along = arc_length(points)
    return np.stack([np.interp(stations, along, points[:, i]) for i in range(2)], axis=1)


def dense(points: FloatArray, spacing: float) -> tuple[FloatArray, float]:
    """Points (m, 2) about ``spacing`` [m] apart from one end of the polyline to the other, and their spacing [m]."""
    length = float(arc_length(points)[-1])
    stations = np.linspace(0.0, length, max(2, int(length / spacing) + 1))
    return resampled(points, stations), float(stations[1])


def sides(line: FloatArray, half_width: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Left and right edge (n, 2) of a strip along a line (n, 2) [m].

    Its half width is one number, or (n, 2) to the left and to the right at the points of the line [m].
    """
    along = np.gradient(line, axis=0)
    along /= np.maximum(np.hypot(*along.T), 1e-12)[:, None]  # repeated points have no direction
    left = np.column_stack([-along[:, 1], along[:, 0]])
    widths = np.broadcast_to(half_width, (len(line), 2))
    return line + widths[:, :1] * left, line - widths[:, 1:] * left


def is_left(line: FloatArray, nearest: NDArray[np.intp], xy: FloatArray) -> NDArray[np.bool_]:
    """True for positions (..., 2) [m] to the left of their nearest points (...) of a line (n, 2) [m]."""
    before, after = np.maximum(nearest - 1, 0), np.minimum(nearest + 1, len(line) - 1)
    along, away = line[after] - line[before], xy - line[nearest]
    return along[..., 0] * away[..., 1] > along[..., 1] * away[..., 0]


def rows_every(points: FloatArray, spacing: float) -> NDArray[np.intp]:
    """Indices of points (n, 2) about ``spacing`` [m] of arc length apart."""
    along = arc_length(points)
    return np.unique(np.searchsorted(along, np.arange(0.0, along[-1], spacing)))
