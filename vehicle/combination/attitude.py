"""Poses of the sprung bodies in space, from the state and the ground, as CasADi expressions."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State
from vehicle.combination.truth_vectors import kinematics
from vehicle.tyres import Num

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class SmoothGround(NamedTuple, Generic[V]):
    """Smooth ground at the support points, front and rear, unit by unit."""

    height: V  # (2 N,) [m]
    slope_x: V  # (2 N,) along W's x [-]
    slope_y: V  # (2 N,) along W's y [-]


def smooth_ground_sizes(vehicle: Vehicle) -> SmoothGround[int]:
    """Length of every part of the vector."""
    n = 2 * len(vehicle.units)
    return SmoothGround(n, n, n)


def body_poses(vehicle: Vehicle, s: State[ca.SX], ground: SmoothGround[ca.SX]) -> ca.SX:
    """X_WB of every sprung body, row by row and unit by unit, (16 N,).

    A body stands on the ground as in ``Surface.pose_on``, with heave, pitch and roll about the point of its roll axis
    below its centre of gravity.
    """
    planar = kinematics(vehicle, s).poses
    poses = []
    for i, unit in enumerate(vehicle.units):
        x, y, psi = (planar[3 * i + k] for k in range(3))
        front, rear = vehicle.supports(i)
        rise = (ground.height[2 * i] - ground.height[2 * i + 1]) / (front - rear)
        across = _mean(ground.slope_y, i) * ca.cos(psi) - _mean(ground.slope_x, i) * ca.sin(psi)
        nose_down = -ca.atan(rise)
        road = _rotation(psi, nose_down, ca.atan(across * ca.cos(nose_down)))
        body = _rotation(0.0, s.pitch[i], s.roll[i])
        pivot = ca.vertcat(unit.cg_x, 0.0, unit.roll_axis_height)
        heaved = pivot + ca.vertcat(0.0, 0.0, s.heave[i])
        origin = ca.vertcat(x, y, ground.height[2 * i + 1] - rise * rear) + road @ (heaved - body @ pivot)
        poses.append(ca.vertcat(ca.horzcat(road @ body, origin), ca.horzcat(0.0, 0.0, 0.0, 1.0)))
    return ca.densify(ca.vertcat(*(ca.vec(X.T) for X in poses)))


def _mean(of_supports: ca.SX, unit: int) -> Num:
    return 0.5 * (of_supports[2 * unit] + of_supports[2 * unit + 1])


def _rotation(yaw: Num, pitch: Num, roll: Num) -> ca.SX:
    """``frames.rotation_zyx`` for symbols."""
    return _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)


def _about(axis: int, angle: Num) -> ca.SX:
    c, s = ca.cos(angle), ca.sin(angle)
    R = ca.SX.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R
