"""Equations of motion of a chain of N hitched units on slipping tyres, from data, as CasADi expressions.

Yaw plane with N + 2 speeds; per wheel its spin, the deflection of its tyre and of its brake; load transfer from
lagged specific forces; slope as gravity along the ground under each unit; steering and drive actuators inside, so
that one step integrates everything. Not modelled: roll and pitch as degrees of freedom, aerodynamic drag, friction
and play of the hitch, contact between the units' bodies.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import casadi as ca

from vehicle.actuators import demand_rate, steer_rate
from vehicle.description import GRAVITY, Vehicle
from vehicle.layout import Input, Output, State, Wheel, steering_actuators, wheels
from vehicle.loads import axle_loads, roll_moments, wheel_load
from vehicle.multibody import Speeds, Vector, acceleration, along, axes, from_unit, levers_to, speed_rates, velocity
from vehicle.tyres import Num, Planar
from vehicle.wheel import WheelMotion, WheelState, road_wheel_angle, wheel_motion


class _Ground(NamedTuple):
    """What the ground does to a unit."""

    force: Vector  # of its tyres, along the tractor's axes [N]
    moment: Num  # of its tyres, about its centre of gravity [N m]
    gravity: Vector  # along the ground, along the tractor's axes [m/s2]


def derivative(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> State[ca.SX]:
    """Time derivative of the state."""
    e, speeds = _kinematics(s)
    rolling = _wheel_motions(vehicle, s, u)
    ground = _ground(vehicle, rolling, s, u)
    forces = [
        Vector(on.force.x + unit.mass * on.gravity.x, on.force.y + unit.mass * on.gravity.y)
        for unit, on in zip(vehicle.units, ground, strict=True)
    ]
    rates = speed_rates(vehicle, ca.vertsplit(s.psi), speeds, forces, [on.moment for on in ground])
    specific = _specific_forces(vehicle, e, speeds, rates, ground)
    felt = [along(axis, force) for axis, force in zip(e, specific, strict=True)]
    hitches = _hitch_forces(vehicle, e, specific, ground)
    travel = from_unit(Vector(ca.cos(s.psi[0]), ca.sin(s.psi[0])), Vector(s.v_x, s.v_y))
    lags = _column(unit.suspension_lag for unit in vehicle.units)
    towed_lags = _column(unit.suspension_lag for unit in vehicle.units[1:])
    return State(
        x=_column([travel.x]),
        y=_column([travel.y]),
        psi=s.yaw_rate,
        v_x=_column([rates.v_x]),
        v_y=_column([rates.v_y]),
        yaw_rate=_column(rates.yaw_rate),
        a_x=(_column(a.x for a in felt) - s.a_x) / lags,
        a_y=(_column(a.y for a in felt) - s.a_y) / lags,
        hitch_x=(_column(F.x for F in hitches) - s.hitch_x) / towed_lags,
        hitch_y=(_column(F.y for F in hitches) - s.hitch_y) / towed_lags,
        omega=_column(wheel.omega for wheel in rolling),
        deflection_x=_column(wheel.deflection.x for wheel in rolling),
        deflection_y=_column(wheel.deflection.y for wheel in rolling),
        brake_windup=_column(wheel.brake_windup for wheel in rolling),
        steer=_steer_rates(vehicle, s, u),
        acceleration=_demand_rate(vehicle, s, u),
    )


def output(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> Output[ca.SX]:
    """What can be told of the wheels, and the forces of the ground on the units."""
    rolling = _wheel_motions(vehicle, s, u)
    ground = _ground(vehicle, rolling, s, u)
    return Output(
        load=_column(_wheel_loads(vehicle, wheels(vehicle), s, u)),
        slip_angle=_column(wheel.slip_angle for wheel in rolling),
        friction_used=_column(wheel.friction_used for wheel in rolling),
        force_x=_column(on.force.x for on in ground),
        force_y=_column(on.force.y for on in ground),
        moment=_column(on.moment for on in ground),
    )


def _column(entries: Iterable[Num]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *entries)  # the empty start makes no entry at all a column too


def _kinematics(s: State[ca.SX]) -> tuple[list[Vector], Speeds]:
    return axes(ca.vertsplit(s.psi)), Speeds(s.v_x, s.v_y, ca.vertsplit(s.yaw_rate))


def _steer_rates(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> ca.SX:
    """Rate of every steered axle's road-wheel angle [rad/s]."""
    return _column(
        steer_rate(s.steer[k], u.steer[k], lag=a.lag, limit=a.limit, rate_limit=a.rate_limit)
        for k, a in enumerate(steering_actuators(vehicle))
    )


def _demand_rate(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> ca.SX:
    drive = vehicle.drive
    rate = demand_rate(
        s.acceleration,
        u.acceleration,
        lag=drive.lag,
        braking=drive.max_deceleration,
        driving=drive.max_acceleration,
    )
    return _column([rate])


def _wheel_loads(vehicle: Vehicle, layout: tuple[Wheel, ...], s: State[ca.SX], u: Input[ca.SX]) -> list[Num]:
    """Vertical load [N] of every wheel."""
    n = len(vehicle.units)
    normal = [ca.sqrt(GRAVITY**2 - u.gravity_x[i] ** 2 - u.gravity_y[i] ** 2) for i in range(n)]
    hitches = [Vector(0.0, 0.0), *(Vector(s.hitch_x[i], s.hitch_y[i]) for i in range(n - 1))]
    pitch = axle_loads(vehicle, normal, ca.vertsplit(s.a_x), hitches, axes(ca.vertsplit(s.psi)))
    roll = roll_moments(vehicle, ca.vertsplit(s.a_y))
    return [wheel_load(pitch[w.unit][w.axle_in_unit], w.roll_share * roll[w.unit], w.side) for w in layout]


def _wheel_motions(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> list[WheelMotion]:
    """The motion of every wheel, front to rear, left before right."""
    e, speeds = _kinematics(s)
    layout = wheels(vehicle)
    loads = _wheel_loads(vehicle, layout, s, u)
    found = []
    for k, wheel in enumerate(layout):
        origin = along(e[wheel.unit], velocity(levers_to(vehicle, wheel.unit, 0.0), e, speeds))
        r = speeds.yaw_rate[wheel.unit]
        state = WheelState(
            omega=s.omega[k],
            deflection=Planar(s.deflection_x[k], s.deflection_y[k]),
            brake_windup=s.brake_windup[k],
            delta=0.0 if wheel.steer is None else road_wheel_angle(wheel.axle, wheel.y, s.steer[wheel.steer]),
            hub=Vector(origin.x - r * wheel.y, origin.y + r * wheel.axle.x),
            load=loads[k],
            friction=u.friction[k],
            acceleration=s.acceleration,
        )
        found.append(wheel_motion(vehicle, wheel, state))
    return found


def _ground(vehicle: Vehicle, rolling: list[WheelMotion], s: State[ca.SX], u: Input[ca.SX]) -> list[_Ground]:
    """What the ground does to each unit."""
    e, _ = _kinematics(s)
    course = Vector(ca.cos(s.psi[0]), ca.sin(s.psi[0]))
    found = []
    for i, unit in enumerate(vehicle.units):
        on = [(w, m.force) for w, m in zip(wheels(vehicle), rolling, strict=True) if w.unit == i]
        found.append(
            _Ground(
                force=from_unit(e[i], Vector(sum(F.x for _, F in on), sum(F.y for _, F in on))),
                moment=sum((w.axle.x - unit.cg_x) * F.y - w.y * F.x for w, F in on),
                gravity=along(course, Vector(u.gravity_x[i], u.gravity_y[i])),
            )
        )
    return found


def _specific_forces(
    vehicle: Vehicle, e: list[Vector], speeds: Speeds, rates: Speeds, ground: list[_Ground]
) -> list[Vector]:
    """Acceleration less gravity at each centre of gravity, along the tractor's axes [m/s2]."""
    found = []
    for i, unit in enumerate(vehicle.units):
        a = acceleration(levers_to(vehicle, i, unit.cg_x), e, speeds, rates)
        found.append(Vector(a.x - ground[i].gravity.x, a.y - ground[i].gravity.y))
    return found


def _hitch_forces(vehicle: Vehicle, e: list[Vector], specific: list[Vector], ground: list[_Ground]) -> list[Vector]:
    """Force at the front hitch of each towed unit, along that unit's axes [N]: what its tyres leave to the hitch."""
    found: list[Vector] = []
    behind = Vector(0.0, 0.0)
    for i in reversed(range(1, len(vehicle.units))):
        mass, tyres = vehicle.units[i].mass, ground[i].force
        behind = Vector(
            mass * specific[i].x - tyres.x + behind.x,
            mass * specific[i].y - tyres.y + behind.y,
        )
        found.insert(0, along(e[i], behind))
    return found
