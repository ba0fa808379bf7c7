"""Equations of motion of a chain of N hitched units on slipping tyres, from data, as CasADi expressions.

Yaw plane with N + 2 speeds; per wheel its spin, the deflection of its tyre and of its brake; each unit's sprung body in
heave, pitch and roll, whose springs and dampers load the wheels; slope as gravity along the ground under each unit;
steering and drive actuators included, so that one step integrates everything. Not modelled: friction of the hitch,
effects of roll and pitch on the yaw plane other than through the loads, contact between the units' bodies, and rolling
over after a side has lifted off.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import casadi as ca

from vehicle.combination.actuators import (
    BrakeRates,
    air_drag,
    brake_rates,
    demand_rate,
    slowing_of,
    steer_rate,
    valve_commands,
)
from vehicle.combination.chain_forces import (
    GroundForce,
    WheelMotion,
    WheelState,
    course_of,
    ground_forces,
    hitch_forces,
    side_forces,
    specific_forces,
    wheel_motion,
    wheel_plane,
)
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Input, Output, State, Wheel, state_sizes, steering_actuators, wheels
from vehicle.combination.loads import ChainLoads, chain_loads, roll_moments, wheel_loads
from vehicle.combination.multibody import (
    Speeds,
    Vector,
    along,
    axes,
    from_unit,
    levers_to,
    speed_rates,
    velocity,
)
from vehicle.combination.roll import LYING, Hitch, UnitSprings, body_moments, springs_of
from vehicle.combination.sprung import Ride, rides, sharing, spring_rates
from vehicle.combination.unit import Unit
from vehicle.tyres import Num, Planar

_AXLE_LAG: Final = 0.016  # [s] of the load transfer by an axle's side force: it rolls on its tyres at about 10 Hz


class _Carried(NamedTuple):
    """Vertical loads, and the moments of axles on bodies in roll if suspensions are given."""

    wheels: list[Num]  # [N]
    chain: ChainLoads
    axle_moments: list[list[Num]]  # of each axle on its unit's body [N m]


class _Moment(NamedTuple):
    """A state with the quantities that follow from it algebraically."""

    layout: tuple[Wheel, ...]
    e: list[Vector]  # directions of the units' x axes
    speeds: Speeds
    springs: list[UnitSprings] | None  # in roll
    bodies: list[Ride]
    carried: _Carried
    rolling: list[WheelMotion]
    ground: list[GroundForce]


def derivative(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> State[ca.SX]:
    """Time derivative of the state."""
    now = _moment(vehicle, s, u)
    brakes = brake_control(vehicle, s, [w.travel for w in now.rolling], [w.omega for w in now.rolling])
    e, rolling, bodies = now.e, now.rolling, now.bodies
    forces = [
        Vector(on.force.x + unit.mass * on.gravity.x, on.force.y + unit.mass * on.gravity.y)
        for unit, on in zip(vehicle.units, now.ground, strict=True)
    ]
    if vehicle.air is not None:
        forces[0] = Vector(forces[0].x - air_drag(vehicle.air, s.v_x), forces[0].y)
    winds, turning = _winds(vehicle, e, now.speeds, s, u), [on.moment for on in now.ground]
    if vehicle.exposed:
        pushes = [from_unit(axis, Vector(0.0, wind)) for axis, wind in zip(e, winds, strict=True)]
        forces = [Vector(F.x + push.x, F.y + push.y) for F, push in zip(forces, pushes, strict=True)]
        turning = [M + _wind_lever(unit) * wind for M, unit, wind in zip(turning, vehicle.units, winds, strict=True)]
    rates = speed_rates(vehicle, ca.vertsplit(s.psi), now.speeds, forces, turning)
    specific = specific_forces(vehicle, e, now.speeds, rates, now.ground)
    felt = [along(axis, force) for axis, force in zip(e, specific, strict=True)]
    springs = [spring_rates(unit, body, a.x, a.y) for unit, body, a in zip(vehicle.units, bodies, felt, strict=True)]
    hitches = hitch_forces(vehicle, e, specific, now.ground, winds)
    course = course_of(s)
    travel = from_unit(course, Vector(s.v_x, s.v_y))
    follow = _column(1.0 / unit.hitch_lag for unit in vehicle.units[1:])
    return State(
        x=_column([travel.x]),
        y=_column([travel.y]),
        psi=s.yaw_rate,
        v_x=_column([rates.v_x]),
        v_y=_column([rates.v_y]),
        yaw_rate=_column(rates.yaw_rate),
        heave=_column(body.rate.heave for body in bodies),
        pitch=_column(body.rate.pitch for body in bodies),
        roll=_column(body.rate.roll for body in bodies),
        heave_spring=_column(rate.heave for rate in springs),
        pitch_spring=_column(rate.pitch for rate in springs),
        roll_spring=_column(_roll_rates(vehicle, now, s, hitches, winds) or (rate.roll for rate in springs)),
        load_shift=_column(sharing(vehicle, now.layout, s, u).rates),
        side_force=_side_force_rates(vehicle, now, s),
        hitch_x=(_column(F.x for F in hitches) - s.hitch_x) * follow,
        hitch_y=(_column(F.y for F in hitches) - s.hitch_y) * follow,
        omega=_column(wheel.omega for wheel in rolling),
        deflection_x=_column(wheel.deflection.x for wheel in rolling),
        deflection_y=_column(wheel.deflection.y for wheel in rolling),
        brake_windup=_column(wheel.brake_windup for wheel in rolling),
        twin_x=_column(twin.x for twin in _twin_rates(rolling)),
        twin_y=_column(twin.y for twin in _twin_rates(rolling)),
        steer=_steer_rates(vehicle, s, u),
        acceleration=_demand_rate(vehicle, s, u),
        brake_pressure=_column(brakes.pressure),
        brake_valve=_column(brakes.valve),
    )


def brake_control(vehicle: Vehicle, s: State[ca.SX], travel: Sequence[Num], spin_rates: Sequence[Num]) -> BrakeRates:
    """Rates of pressures and valves, from each wheel's ``wheel_travel`` [m/s] and rate of spin [rad/s2]."""
    layout = wheels(vehicle)
    return brake_rates(vehicle, layout, s, valve_commands(vehicle, layout, s, travel, spin_rates))


def wheel_travel(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> ca.SX:
    """Magnitude of every wheel's velocity along its plane [m/s]."""
    return _column(wheel.travel for wheel in _moment(vehicle, s, u).rolling)


def relaxation(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> State[ca.SX]:
    """Relaxation rate of every state with the others held [1/s], for the integrator; 0 where not stiff."""
    of_wheels = [motion.relaxation for motion in _moment(vehicle, s, u).rolling]
    deflection = _column(wheel.deflection for wheel in of_wheels)
    twin = _column(wheel.twin for wheel in of_wheels if wheel.twin is not None)
    none = State(*(ca.SX(size, 1) for size in state_sizes(vehicle)))
    return none._replace(
        omega=_column(wheel.omega for wheel in of_wheels),
        deflection_x=deflection,
        deflection_y=deflection,
        brake_windup=_column(wheel.brake_windup for wheel in of_wheels),
        twin_x=twin,
        twin_y=twin,
    )


def output(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> Output[ca.SX]:
    """Outputs of the wheels, and the forces of the ground on the units."""
    now = _moment(vehicle, s, u)
    return Output(
        load=_column(now.carried.wheels),
        slip_angle=_column(wheel.slip_angle for wheel in now.rolling),
        friction_used=_column(wheel.friction_used for wheel in now.rolling),
        force_x=_column(on.force.x for on in now.ground),
        force_y=_column(on.force.y for on in now.ground),
        moment=_column(on.moment for on in now.ground),
        lateral_load_transfer=_column(_load_transfers(vehicle, now)),
    )


def _twin_rates(rolling: Iterable[WheelMotion]) -> list[Planar]:
    """Rates of the inner patches' deflections, of the wheels that have one."""
    return [wheel.twin for wheel in rolling if wheel.twin is not None]


def _moment(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> _Moment:
    """Quantities that follow from the state algebraically."""
    layout = wheels(vehicle)
    psi = ca.vertsplit(s.psi)
    e, speeds = axes(psi), Speeds(s.v_x, s.v_y, ca.vertsplit(s.yaw_rate))
    springs = springs_of(vehicle) if vehicle.has_springs else None
    bodies = rides(vehicle, layout, s, u, springs)
    carried = _carried(vehicle, layout, e, springs, bodies, s, u)
    slowing = _with_further_brakes(vehicle, layout, slowing_of(vehicle, layout, s, u.brake_share), u)
    rolling = _wheel_motions(vehicle, layout, e, speeds, carried.wheels, slowing, s, u)
    ground = ground_forces(vehicle, layout, e, rolling, s, u)
    return _Moment(layout, e, speeds, springs, bodies, carried, rolling, ground)


def _with_further_brakes(vehicle: Vehicle, layout: Sequence[Wheel], slowing: list[Num], u: Input[ca.SX]) -> list[Num]:
    """Rates of the spins that brakes can cause [rad/s2], with the torques that inputs give for the axles."""
    if not vehicle.has_torque_inputs:
        return slowing
    return [
        rate - (0.5 / wheel.axle.wheel_inertia) * ca.fmax(u.brake_torque[k // 2], 0.0)
        for k, (wheel, rate) in enumerate(zip(layout, slowing, strict=True))
    ]


def _column(entries: Iterable[Num]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *entries)  # the empty start makes a column of no entries, too


def _steer_rates(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> ca.SX:
    """Rate of every steering actuator's angle [rad/s]."""
    return _column(
        steer_rate(s.steer[k], u.steer[k], lag=a.lag, limit=a.limit, rate_limit=a.rate_limit)
        for k, a in enumerate(steering_actuators(vehicle))
    )


def _demand_rate(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> ca.SX:
    drive, brakes = vehicle.drive, vehicle.brakes
    rate = demand_rate(
        s.acceleration,
        u.acceleration,
        lag=drive.lag if brakes is None else ca.if_else(u.acceleration < 0.0, brakes.lag, drive.lag),
        braking=drive.max_deceleration,
        driving=drive.max_acceleration,
    )
    return _column([rate])


def _carried(
    vehicle: Vehicle,
    layout: tuple[Wheel, ...],
    e: list[Vector],
    springs: list[UnitSprings] | None,
    bodies: list[Ride],
    s: State[ca.SX],
    u: Input[ca.SX],
) -> _Carried:
    """Vertical load [N] of every wheel, axle and hitch."""
    n = len(vehicle.units)
    normal = [ca.sqrt(GRAVITY**2 - u.gravity_x[i] ** 2 - u.gravity_y[i] ** 2) for i in range(n)]
    gravity = [g + body.felt.heave for g, body in zip(normal, bodies, strict=True)]
    hitches = [Vector(0.0, 0.0), *(Vector(s.hitch_x[i], s.hitch_y[i]) for i in range(n - 1))]
    additional = sharing(vehicle, layout, s, u).additional
    chain = chain_loads(vehicle, gravity, [body.felt.pitch for body in bodies], hitches, e, additional)
    axles = list(enumerate(layout[::2]))  # the left wheels; the right ones follow them
    loads: list[Num] = []
    moments: list[list[Num]] = [[] for _ in vehicle.units]
    if springs is None:
        on_units = roll_moments(vehicle, [body.felt.roll for body in bodies], ca.vertsplit(s.roll), gravity)
        for _, wheel in axles:
            loads += wheel_loads(chain.axles[wheel.unit][wheel.axle_in_unit], wheel.roll_share * on_units[wheel.unit])
        return _Carried(loads, chain, moments)
    for k, wheel in axles:
        axle_load = chain.axles[wheel.unit][wheel.axle_in_unit]
        spring = springs[wheel.unit].axles[wheel.axle_in_unit]
        body = bodies[wheel.unit]
        left, right = wheel_loads(axle_load, spring.transfer(body.leans[wheel.axle_in_unit], s.side_force[k]))
        angle = body.angles[wheel.axle_in_unit]
        moments[wheel.unit].append(spring.body_moment(angle, s.side_force[k], right - left))
        loads += [left, right]
    return _Carried(loads, chain, moments)


def _winds(vehicle: Vehicle, e: list[Vector], speeds: Speeds, s: State[ca.SX], u: Input[ca.SX]) -> list[Num]:
    """Force of the wind on each unit along its y axis [N]; zeros if the vehicle is not exposed."""
    if not vehicle.exposed:
        return [0.0] * len(vehicle.units)
    course = course_of(s)
    wind = [along(course, Vector(0.0, u.wind[i])) for i in range(len(vehicle.units))]
    return side_forces(vehicle, e, speeds, wind)


def _wind_lever(unit: Unit) -> Num:
    """Distance of the pressure's centre ahead of the centre of gravity [m]."""
    return 0.0 if unit.side_wind is None else unit.side_wind.x - unit.cg_x


def _roll_rates(
    vehicle: Vehicle, now: _Moment, s: State[ca.SX], hitch_forces: list[Vector], winds: list[Num]
) -> list[Num]:
    """Rates of the bodies' companions in roll [rad/s2]; none if their springs are not given."""
    if now.springs is None:
        return []
    hitches = [
        Hitch(
            force=force,
            ahead=along(now.e[i], from_unit(now.e[i + 1], force)),
            load=load,
            cosine=along(now.e[i], now.e[i + 1]).x,
        )
        for i, (force, load) in enumerate(zip(hitch_forces, now.carried.chain.hitches, strict=True))
    ]
    roll = [ca.fmin(ca.fmax(angle, -LYING), LYING) for angle in ca.vertsplit(s.roll)]
    carried = now.carried
    moments = body_moments(vehicle, now.springs, roll, carried.chain.axles, carried.axle_moments, hitches)
    for i, unit in enumerate(vehicle.units):
        if vehicle.exposed and unit.side_wind is not None:  # above the centre of gravity it rolls the left side down
            moments[i] = moments[i] - (unit.side_wind.height - unit.cg_height) * winds[i]
    # The dampers are in the springs' moments, as they act only while the wheels stand; the companion has them again.
    return [
        1.0 / springs.inertia * moment + springs.damping * body.rate.roll
        for springs, moment, body in zip(now.springs, moments, now.bodies, strict=True)
    ]


def _side_force_rates(vehicle: Vehicle, now: _Moment, s: State[ca.SX]) -> ca.SX:
    if now.springs is None:
        return ca.SX(0, 1)
    return (_column(side for on in now.ground for side in on.sides) - s.side_force) * (1.0 / _AXLE_LAG)


def _load_transfers(vehicle: Vehicle, now: _Moment) -> list[Num]:
    """Right less left wheel loads of each unit over their sum."""
    transfers = []
    for i in range(len(vehicle.units)):
        left, right = (
            sum(load for w, load in zip(now.layout, now.carried.wheels, strict=True) if (w.unit, w.side) == (i, side))
            for side in (+1, -1)
        )
        transfers.append((right - left) / (right + left))
    return transfers


def _wheel_motions(
    vehicle: Vehicle,
    layout: tuple[Wheel, ...],
    e: list[Vector],
    speeds: Speeds,
    loads: list[Num],
    slowing: list[Num],
    s: State[ca.SX],
    u: Input[ca.SX],
) -> list[WheelMotion]:
    """The motion of every wheel, front to rear, left before right."""
    origins = [along(e[i], velocity(levers_to(vehicle, i, 0.0), e, speeds)) for i in range(len(vehicle.units))]
    motions = []
    for k, wheel in enumerate(layout):
        r = speeds.yaw_rate[wheel.unit]
        turning = wheel.side * ((0.5 * wheel.axle.track) * r)  # the same product for both sides
        state = WheelState(
            omega=s.omega[k],
            deflection=Planar(s.deflection_x[k], s.deflection_y[k]),
            twin=None if wheel.twin is None else Planar(s.twin_x[wheel.twin], s.twin_y[wheel.twin]),
            brake_windup=s.brake_windup[k],
            plane=_plane(vehicle, wheel, k, s, u),
            hub=Vector(origins[wheel.unit].x - turning, origins[wheel.unit].y + wheel.axle.x * r),
            yaw_rate=r,
            travel=origins[wheel.unit].x,
            load=loads[k],
            friction=u.friction[k],
            acceleration=s.acceleration,
            slowing=slowing[k],
            gear=u.gear,
            torque=0.5 * u.drive_torque[k // 2] if vehicle.has_torque_inputs else None,
        )
        motions.append(wheel_motion(vehicle, wheel, state))
    return motions


def _plane(vehicle: Vehicle, wheel: Wheel, k: int, s: State[ca.SX], u: Input[ca.SX]) -> Vector:
    """Direction of the plane of wheel number ``k``: turned by its actuator, and by its suspension as the body moves."""
    axle = wheel.axle
    angles: list[Num] = [] if wheel.steer is None else [wheel.steer_ratio * s.steer[wheel.steer]]
    if axle.roll_steer is not None:
        left, right = (k, k + 1) if wheel.side > 0 else (k - 1, k)
        angles.append(axle.roll_steer * (s.roll[wheel.unit] - (1.0 / axle.track) * (u.road[left] - u.road[right])))
    if axle.bump_steer is not None:
        lever = axle.x - vehicle.units[wheel.unit].cg_x
        body = s.heave[wheel.unit] - lever * s.pitch[wheel.unit] + wheel.y * s.roll[wheel.unit]
        angles.append((wheel.side * axle.bump_steer) * (body - u.road[k]))
    return wheel_plane(axle, wheel.y, sum(angles[1:], angles[0])) if angles else Vector(1.0, 0.0)
