"""Ground truth as CasADi expressions: motion and poses of units, forces of wheels; and Truth from vectors."""

from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.chain import output
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Chain, Input, State, slices, turned_axles, wheels
from vehicle.combination.multibody import Speeds, Vector, along, axes, from_unit, levers_to, velocity
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.tyres import Num

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class Kinematics(NamedTuple, Generic[V]):
    """Positions and velocities in the plane; the field order is the order in the vector. Wheels as in ``State``."""

    poses: V  # (3 N,) x [m], y [m], psi [rad] of each unit's frame in W, unit by unit
    velocities: V  # (3 N,) v_x, v_y [m/s] of each frame's origin along its unit's axes and yaw rate [rad/s]
    centre_x: V  # (N,) of each centre of gravity in W [m]
    centre_y: V  # (N,)
    wheel_x: V  # (n_wheels,) in W [m]
    wheel_y: V  # (n_wheels,)
    support_x: V  # (2 N,) support points of each unit, front and rear, unit by unit, in W [m]
    support_y: V  # (2 N,)


class WheelTruth(NamedTuple, Generic[V]):
    """True state of axles and wheels; the field order is the order in the vector. Wheels as in ``State``."""

    steer: V  # (n_steered,) angle of every steered axle, front to rear [rad]
    loads: V  # (n_wheels,) vertical tyre force [N]
    slip_angles: V  # (n_wheels,) [rad]
    friction_used: V  # (n_wheels,) horizontal tyre force / (mu F_z) [-]
    load_transfer: V  # (N,) right less left wheel loads of each unit over their sum [-]


def wheel_truth_sizes(vehicle: Vehicle) -> WheelTruth[int]:
    """Length of every part of the vector."""
    n, n_steered = vehicle.n_wheels, sum(len(unit.steered_axles) for unit in vehicle.units)
    return WheelTruth(n_steered, n, n, n, len(vehicle.units))


def wheel_truth(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> WheelTruth[ca.SX]:
    """Ground truth of axles and wheels in this state."""
    outputs = output(Chain.of(vehicle), s, u)
    angles = {axle: ratio * s.steer[k] for k, turned in enumerate(turned_axles(vehicle)) for axle, ratio in turned}
    return WheelTruth(
        steer=ca.vertcat(*(angles[axle] for axle in sorted(angles))),
        loads=outputs.load,
        slip_angles=outputs.slip_angle,
        friction_used=outputs.friction_used,
        load_transfer=outputs.lateral_load_transfer,
    )


class TruthAssembly:
    """Builds ``Truth`` for vehicles of one topology."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._kinematics = Kinematics(*slices(kinematics_sizes(vehicle)))
        self._wheels = WheelTruth(*slices(wheel_truth_sizes(vehicle)))

    def truth(self, tick: int, kinematics: FloatArray, wheels: FloatArray, bodies: FloatArray) -> Truth:
        """Ground truth from the vectors ``Kinematics`` and ``WheelTruth``, and all X_WB row by row."""
        return Truth(
            tick=tick,
            poses=kinematics[self._kinematics.poses].reshape(-1, 3),
            velocities=kinematics[self._kinematics.velocities].reshape(-1, 3),
            bodies=bodies.reshape(-1, 4, 4),
            steer=wheels[self._wheels.steer],
            wheel_loads=wheels[self._wheels.loads],
            wheel_slip_angles=wheels[self._wheels.slip_angles],
            friction_used=wheels[self._wheels.friction_used],
            load_transfer=wheels[self._wheels.load_transfer],
        )


def kinematics_sizes(vehicle: Vehicle) -> Kinematics[int]:
    """Length of every part of the vector."""
    N, n_wheels = len(vehicle.units), vehicle.n_wheels
    return Kinematics(3 * N, 3 * N, N, N, n_wheels, n_wheels, 2 * N, 2 * N)


def kinematics(vehicle: Vehicle, s: State[ca.SX]) -> Kinematics[ca.SX]:
    """Positions of units, wheels and supports, and velocities of the units."""
    units = range(len(vehicle.units))
    psi, yaw_rate = ca.vertsplit(s.psi), ca.vertsplit(s.yaw_rate)
    in_T = axes(psi)
    speeds = [
        along(e, velocity(levers_to(vehicle, i, 0.0), in_T, Speeds(s.v_x, s.v_y, yaw_rate))) for i, e in enumerate(in_T)
    ]
    in_W = [Vector(ca.cos(angle), ca.sin(angle)) for angle in psi]
    origins = _origins(vehicle, Vector(s.x, s.y), in_W)

    def at(unit: int, x: Num, y: Num = 0.0) -> Vector:
        return origins[unit] + from_unit(in_W[unit], Vector(x, y))

    centres = [at(i, unit.cg_x) for i, unit in enumerate(vehicle.units)]
    contacts = [at(wheel.unit, wheel.axle.x, wheel.y) for wheel in wheels(vehicle)]
    supports = [at(i, x) for i in units for x in vehicle.supports(i)]
    return Kinematics(
        poses=ca.vertcat(*(value for i in units for value in (origins[i].x, origins[i].y, psi[i]))),
        velocities=ca.vertcat(*(value for i in units for value in (speeds[i].x, speeds[i].y, yaw_rate[i]))),
        centre_x=ca.vertcat(*(p.x for p in centres)),
        centre_y=ca.vertcat(*(p.y for p in centres)),
        wheel_x=ca.vertcat(*(p.x for p in contacts)),
        wheel_y=ca.vertcat(*(p.y for p in contacts)),
        support_x=ca.vertcat(*(p.x for p in supports)),
        support_y=ca.vertcat(*(p.y for p in supports)),
    )


def _origins(vehicle: Vehicle, first: Vector, in_W: Sequence[Vector]) -> list[Vector]:
    """Origin of each unit's frame in W [m]."""
    origins = [first]
    for ahead, e in zip(vehicle.units[:-1], in_W[:-1], strict=True):
        origins.append(origins[-1] + e * ahead.rear_hitch[0])
    return origins


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
