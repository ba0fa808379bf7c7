"""Equations of motion of a chain of N hitched units on slipping tyres, and its ground truth, as CasADi expressions.

Yaw plane with N + 2 speeds; per wheel its spin, the deflection of its tyre and of its brake; each unit's sprung body in
heave, pitch and roll, whose springs and dampers load the wheels; slope as gravity along the ground under each unit;
steering and drive actuators included, so that one step integrates everything. Not modelled: friction of the hitch,
effects of roll and pitch on the yaw plane other than through the loads, contact between the units' bodies, and rolling
over after a side has lifted off.
"""

from collections.abc import Iterable, Sequence
from typing import Final, Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.actuators import air_drag, brake_decelerations, brake_rates, demand_rate, steer_rate
from vehicle.combination.chain_forces import (
    GroundForce,
    WheelMotion,
    ground_forces,
    heading,
    hitch_forces,
    specific_forces,
    wheel_motions,
    wind_forces,
    wind_lever,
)
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Chain, Input, Output, State, slices, state_sizes, turned_axles, wheels
from vehicle.combination.loads import ChainLoads, chain_loads, roll_moments, wheel_loads
from vehicle.combination.multibody import ZERO, Speeds, Vector, along, axes, from_unit, levers_to, speed_rates, velocity
from vehicle.combination.roll import LYING, Hitch, body_moments
from vehicle.combination.sprung import Attitude, LoadShifts, Ride, load_shifts, rides, spring_rates
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.tyres import Num, Planar

_AXLE_LAG: Final = 0.016  # [s] of the load transfer by an axle's side force: it rolls on its tyres at about 10 Hz


class _VerticalLoads(NamedTuple):
    """Vertical loads, and the moments of axles on bodies in roll if suspensions are given."""

    wheels: list[Num]  # [N]
    chain: ChainLoads
    axle_moments: list[list[Num]]  # of each axle on its unit's body [N m]


class _Algebraic(NamedTuple):
    """Algebraic variables: what follows from state and input without integration."""

    e: list[Vector]  # directions of the units' x axes, in T
    speeds: Speeds
    bodies: list[Ride]
    shifts: LoadShifts
    loads: _VerticalLoads
    wheels: list[WheelMotion]
    ground: list[GroundForce]
    wind: list[Num]  # force on each unit along its y axis [N]


def derivative(chain: Chain, s: State[ca.SX], u: Input[ca.SX]) -> State[ca.SX]:
    """Time derivative of the state."""
    z = _algebraic(chain, s, u)
    rates = _speed_rates(chain, z, s)
    specific = specific_forces(chain, z.e, z.speeds, rates, z.ground)
    springs = _spring_rates(chain, z, specific)
    hitches = hitch_forces(chain, z.e, specific, z.ground, z.wind)
    brakes = brake_rates(chain, s, [wheel.travel for wheel in z.wheels], [wheel.omega for wheel in z.wheels])
    velocity = from_unit(heading(s), Vector(s.v_x, s.v_y))  # of To in W
    hitch_bandwidth = _column(1.0 / unit.hitch_lag for unit in chain.units[1:])
    return State(
        x=_column([velocity.x]),
        y=_column([velocity.y]),
        psi=s.yaw_rate,
        v_x=_column([rates.v_x]),
        v_y=_column([rates.v_y]),
        yaw_rate=_column(rates.yaw_rate),
        heave=_column(body.rate.heave for body in z.bodies),
        pitch=_column(body.rate.pitch for body in z.bodies),
        roll=_column(body.rate.roll for body in z.bodies),
        heave_spring=_column(rate.heave for rate in springs),
        pitch_spring=_column(rate.pitch for rate in springs),
        roll_spring=_column(_coupled_roll_rates(chain, z, s, hitches) or (rate.roll for rate in springs)),
        load_shift=_column(z.shifts.rates),
        side_force=_side_force_rates(chain, z, s),
        hitch_x=(_column(F.x for F in hitches) - s.hitch_x) * hitch_bandwidth,
        hitch_y=(_column(F.y for F in hitches) - s.hitch_y) * hitch_bandwidth,
        omega=_column(wheel.omega for wheel in z.wheels),
        deflection_x=_column(wheel.deflection.x for wheel in z.wheels),
        deflection_y=_column(wheel.deflection.y for wheel in z.wheels),
        brake_windup=_column(wheel.brake_windup for wheel in z.wheels),
        twin_x=_column(twin.x for twin in _twin_rates(z.wheels)),
        twin_y=_column(twin.y for twin in _twin_rates(z.wheels)),
        steer=_steer_rates(chain, s, u),
        acceleration=_demand_rate(chain, s, u),
        brake_pressure=_column(brakes.pressure),
        brake_valve=_column(brakes.valve),
    )


def wheel_travel(chain: Chain, s: State[ca.SX], u: Input[ca.SX]) -> ca.SX:
    """Magnitude of every wheel's velocity along its plane [m/s]."""
    return _column(wheel.travel for wheel in _algebraic(chain, s, u).wheels)


def relaxation(chain: Chain, s: State[ca.SX], u: Input[ca.SX]) -> State[ca.SX]:
    """Relaxation rate of every state with the others held [1/s], for the integrator; 0 where not stiff."""
    of_wheels = [wheel.relaxation for wheel in _algebraic(chain, s, u).wheels]
    twins = [wheel.twin for wheel in of_wheels if wheel.twin is not None]
    none = State(*(ca.SX(size, 1) for size in state_sizes(chain.vehicle)))
    return none._replace(
        omega=_column(wheel.omega for wheel in of_wheels),
        deflection_x=_column(wheel.deflection.x for wheel in of_wheels),
        deflection_y=_column(wheel.deflection.y for wheel in of_wheels),
        brake_windup=_column(wheel.brake_windup for wheel in of_wheels),
        twin_x=_column(twin.x for twin in twins),
        twin_y=_column(twin.y for twin in twins),
    )


def output(chain: Chain, s: State[ca.SX], u: Input[ca.SX]) -> Output[ca.SX]:
    """Outputs of the wheels, and the forces of the ground on the units."""
    z = _algebraic(chain, s, u)
    return Output(
        load=_column(z.loads.wheels),
        slip_angle=_column(wheel.slip_angle for wheel in z.wheels),
        friction_used=_column(wheel.friction_used for wheel in z.wheels),
        force_x=_column(on.force.x for on in z.ground),
        force_y=_column(on.force.y for on in z.ground),
        moment=_column(on.moment for on in z.ground),
        lateral_load_transfer=_column(_load_transfers(chain, z.loads.wheels)),
    )


def _algebraic(chain: Chain, s: State[ca.SX], u: Input[ca.SX]) -> _Algebraic:
    """Algebraic variables, from the bodies down to the ground."""
    e, speeds = axes(ca.vertsplit(s.psi)), Speeds(s.v_x, s.v_y, ca.vertsplit(s.yaw_rate))
    bodies, shifts = rides(chain, s, u), load_shifts(chain, s, u)
    loads = _vertical_loads(chain, e, bodies, shifts, s, u)
    wheels = wheel_motions(chain, e, speeds, loads.wheels, brake_decelerations(chain, s, u), s, u)
    ground = ground_forces(chain, e, wheels, s, u)
    return _Algebraic(e, speeds, bodies, shifts, loads, wheels, ground, wind_forces(chain, e, speeds, s, u))


def _speed_rates(chain: Chain, z: _Algebraic, s: State[ca.SX]) -> Speeds:
    """Rates of the speeds under the forces of ground, gravity and air."""
    forces: list[Vector] = []
    moments: list[Num] = []
    for unit, e, ground, wind in zip(chain.units, z.e, z.ground, z.wind, strict=True):
        drag = Vector(0.0 if forces else air_drag(chain.vehicle.air, s.v_x), 0.0)  # of the whole, on the tractor
        forces.append(ground.force + ground.gravity * unit.mass - drag + from_unit(e, Vector(0.0, wind)))
        moments.append(ground.moment + wind_lever(unit) * wind)
    return speed_rates(chain.vehicle, ca.vertsplit(s.psi), z.speeds, forces, moments)


def _twin_rates(wheels: Iterable[WheelMotion]) -> list[Planar]:
    """Rates of the inner patches' deflections, of the wheels that have one."""
    return [wheel.twin for wheel in wheels if wheel.twin is not None]


def _column(entries: Iterable[Num]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *entries)  # the empty start makes a column of no entries, too


def _steer_rates(chain: Chain, s: State[ca.SX], u: Input[ca.SX]) -> ca.SX:
    """Rate of every steering actuator's angle [rad/s]."""
    return _column(
        steer_rate(s.steer[k], u.steer[k], lag=a.lag, limit=a.limit, rate_limit=a.rate_limit)
        for k, a in enumerate(chain.actuators)
    )


def _demand_rate(chain: Chain, s: State[ca.SX], u: Input[ca.SX]) -> ca.SX:
    drive, brakes = chain.vehicle.drive, chain.vehicle.brakes
    rate = demand_rate(
        s.acceleration,
        u.acceleration,
        lag=drive.lag if brakes is None else ca.if_else(u.acceleration < 0.0, brakes.lag, drive.lag),
        braking=drive.max_deceleration,
        driving=drive.max_acceleration,
    )
    return _column([rate])


def _vertical_loads(
    chain: Chain, e: list[Vector], bodies: list[Ride], shifts: LoadShifts, s: State[ca.SX], u: Input[ca.SX]
) -> _VerticalLoads:
    """Vertical load [N] of every wheel, axle and hitch."""
    n = len(chain.units)
    normal = [ca.sqrt(GRAVITY**2 - u.gravity_x[i] ** 2 - u.gravity_y[i] ** 2) for i in range(n)]
    gravity = [g + body.felt.heave for g, body in zip(normal, bodies, strict=True)]
    hitches = [ZERO, *(Vector(s.hitch_x[i], s.hitch_y[i]) for i in range(n - 1))]
    of_chain = chain_loads(chain.vehicle, gravity, [body.felt.pitch for body in bodies], hitches, e, shifts.additional)
    loads: list[Num] = []
    moments: list[list[Num]] = [[] for _ in chain.units]
    if chain.springs is None:
        on_units = roll_moments(chain.vehicle, [body.felt.roll for body in bodies], ca.vertsplit(s.roll), gravity)
        for axle in chain.axles:
            loads += wheel_loads(of_chain.axles[axle.unit][axle.axle_in_unit], axle.roll_share * on_units[axle.unit])
        return _VerticalLoads(loads, of_chain, moments)
    for k, axle in enumerate(chain.axles):
        i, n = axle.unit, axle.axle_in_unit
        spring, body = chain.springs[i].axles[n], bodies[i]
        left, right = wheel_loads(of_chain.axles[i][n], spring.transfer(body.leans[n], s.side_force[k]))
        moments[i].append(spring.body_moment(body.angles[n], s.side_force[k], right - left))
        loads += [left, right]
    return _VerticalLoads(loads, of_chain, moments)


def _spring_rates(chain: Chain, z: _Algebraic, specific: list[Vector]) -> list[Attitude]:
    """Rates of the bodies' auxiliary states under their specific forces, by gradients and frequencies."""
    felt = [along(e, force) for e, force in zip(z.e, specific, strict=True)]
    return [spring_rates(unit, body, a.x, a.y) for unit, body, a in zip(chain.units, z.bodies, felt, strict=True)]


def _coupled_roll_rates(chain: Chain, z: _Algebraic, s: State[ca.SX], hitch_forces: list[Vector]) -> list[Num]:
    """Rates of the bodies' auxiliary states in roll [rad/s2], coupled by suspensions and hitches; none without data."""
    if chain.springs is None:
        return []
    hitches = [
        Hitch(
            force=force,
            ahead=along(z.e[i], from_unit(z.e[i + 1], force)),
            load=load,
            cosine=along(z.e[i], z.e[i + 1]).x,
        )
        for i, (force, load) in enumerate(zip(hitch_forces, z.loads.chain.hitches, strict=True))
    ]
    roll = [ca.fmin(ca.fmax(angle, -LYING), LYING) for angle in ca.vertsplit(s.roll)]
    moments = body_moments(chain.vehicle, chain.springs, roll, z.loads.chain.axles, z.loads.axle_moments, hitches)
    for i, unit in enumerate(chain.units):
        if unit.side_wind is not None:  # above the centre of gravity it rolls the left side down
            moments[i] = moments[i] - (unit.side_wind.height - unit.cg_height) * z.wind[i]
    # The dampers are in the springs' moments, as they act only while the wheels stand; the auxiliary state has them
    # again.
    return [
        1.0 / springs.inertia * moment + springs.damping * body.rate.roll
        for springs, moment, body in zip(chain.springs, moments, z.bodies, strict=True)
    ]


def _side_force_rates(chain: Chain, z: _Algebraic, s: State[ca.SX]) -> ca.SX:
    if chain.springs is None:
        return ca.SX(0, 1)
    return (_column(side for on in z.ground for side in on.sides) - s.side_force) * (1.0 / _AXLE_LAG)


def _load_transfers(chain: Chain, loads: list[Num]) -> list[Num]:
    """Right less left wheel loads of each unit over their sum."""
    transfers = []
    for i in range(len(chain.units)):
        left, right = (
            sum(load for w, load in zip(chain.wheels, loads, strict=True) if (w.unit, w.side) == (i, side))
            for side in (+1, -1)
        )
        transfers.append((right - left) / (right + left))
    return transfers


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
    speeds: V  # (n_wheels,) of the tread, by the wheel's rotation [m/s]


def wheel_truth_sizes(vehicle: Vehicle) -> WheelTruth[int]:
    """Length of every part of the vector."""
    n, n_steered = vehicle.n_wheels, sum(len(unit.steered_axles) for unit in vehicle.units)
    return WheelTruth(n_steered, n, n, n, len(vehicle.units), n)


def wheel_truth(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX]) -> WheelTruth[ca.SX]:
    """Ground truth of axles and wheels in this state."""
    chain = Chain.of(vehicle)
    outputs = output(chain, s, u)
    angles = {axle: ratio * s.steer[k] for k, turned in enumerate(turned_axles(vehicle)) for axle, ratio in turned}
    return WheelTruth(
        steer=ca.vertcat(*(angles[axle] for axle in sorted(angles))),
        loads=outputs.load,
        slip_angles=outputs.slip_angle,
        friction_used=outputs.friction_used,
        load_transfer=outputs.lateral_load_transfer,
        speeds=ca.vertcat(*(wheel.axle.wheel_radius * s.omega[k] for k, wheel in enumerate(chain.wheels))),
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
            wheel_speeds=wheels[self._wheels.speeds],
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
