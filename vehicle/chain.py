"""Equations of motion of a chain of N hitched units on slipping tyres, from data, as CasADi expressions.

Yaw plane with N + 2 speeds; per wheel its spin, the deflection of its tyre and of its brake; load transfer from
lagged specific forces; slope as gravity along the ground under each unit; steering and drive actuators inside, so
that one step integrates everything. Not modelled: roll and pitch as degrees of freedom, aerodynamic drag, friction
and play of the hitch, contact between the units' bodies.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import casadi as ca

from vehicle.actuators import demand_rate, steer_rate
from vehicle.description import GRAVITY, Axle, Vehicle
from vehicle.layout import Input, Output, State, Wheel, steering_actuators, wheels
from vehicle.loads import axle_loads, roll_moments, wheel_load
from vehicle.multibody import Speeds, Vector, acceleration, along, axes, from_unit, levers_to, speed_rates, velocity
from vehicle.tyres import Num, Planar, deflection_rate, force

_BRAKE_WINDUP: Final = 0.02  # turn over which a brake's holding torque builds up [rad]: 1 cm at the tread
_BRAKE_DAMPING: Final = 0.005  # its damping over its stiffness [s]: near critical for a laden wheel at full braking
_ROLLING_OMEGA: Final = 0.4  # spin over which rolling resistance builds up [rad/s]: 0.2 m/s


class _WheelRates(NamedTuple):
    """Rates of a wheel's states, the force on its unit, and what there is to tell of it."""

    force: Vector  # on the unit, along the unit's axes [N]
    omega: Num
    deflection: Planar
    brake_windup: Num
    slip_angle: Num  # [rad]
    friction_used: Num


def derivative(vehicle: Vehicle, state: State[ca.SX], u: Input[ca.SX]) -> State[ca.SX]:
    """Time derivative of the state."""
    return _evaluate(vehicle, state, u)[0]


def output(vehicle: Vehicle, state: State[ca.SX], u: Input[ca.SX]) -> Output[ca.SX]:
    """What can be told of the wheels, and the forces of the ground."""
    return _evaluate(vehicle, state, u)[1]


def _evaluate(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> tuple[State[ca.SX], Output[ca.SX]]:
    units = range(len(vehicle.units))
    layout = wheels(vehicle)
    psi = [s.psi[i] for i in units]
    e = axes(psi)
    speeds = Speeds(s.v_x, s.v_y, [s.yaw_rate[i] for i in units])

    loads = _wheel_loads(vehicle, layout, s, u, e)
    rolling = [
        _wheel(vehicle, wheel, k, s, u, along(e[wheel.unit], velocity(levers_to(vehicle, wheel.unit, 0.0), e, speeds)), loads[k])
        for k, wheel in enumerate(layout)
    ]
    forces, moments = _resultants(vehicle, layout, rolling, e)
    weight = [Vector(*along(e[0], _world_to_tractor(s.psi[0], u.gravity_x[i], u.gravity_y[i]))) for i in units]
    pulled = [
        Vector(forces[i].x + vehicle.units[i].mass * weight[i].x, forces[i].y + vehicle.units[i].mass * weight[i].y)
        for i in units
    ]
    rates = speed_rates(vehicle, psi, speeds, pulled, moments)
    return _pack(...)
