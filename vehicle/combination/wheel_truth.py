"""Ground truth of steered axles and wheels as a CasADi expression, and ``Truth`` from the vectors of the plants."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.chain import output
from vehicle.combination.description import Vehicle
from vehicle.combination.kinematics import Kinematics, kinematics_sizes
from vehicle.combination.layout import Input, State, turned_axles
from vehicle.combination.plant_inputs import slices
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


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
