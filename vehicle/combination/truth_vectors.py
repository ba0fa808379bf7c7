"""Ground truth as CasADi expressions: motion of units and wheels, forces of wheels; and ``Truth`` from the vectors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.chain import output
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Input, State, turned_axles, wheels
from vehicle.combination.multibody import Speeds, Vector, along, axes, from_unit, levers_to, velocity
from vehicle.combination.plant_inputs import slices
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
    outputs = output(vehicle, s, u)
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
        offset = from_unit(in_W[unit], Vector(x, y))
        return Vector(origins[unit].x + offset.x, origins[unit].y + offset.y)

    centres = [at(i, unit.cg_x) for i, unit in enumerate(vehicle.units)]
    contacts = [at(wheel.unit, wheel.axle.x, wheel.y) for wheel in wheels(vehicle)]
    supports = [at(i, x) for i in units for x in vehicle.supports(i)]
    return Kinematics(
        poses=ca.vertcat(*(value for i in units for value in (*origins[i], psi[i]))),
        velocities=ca.vertcat(*(value for i in units for value in (*speeds[i], yaw_rate[i]))),
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
        hitch, _ = ahead.rear_hitch
        origins.append(Vector(origins[-1].x + hitch * e.x, origins[-1].y + hitch * e.y))
    return origins
