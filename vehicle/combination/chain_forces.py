"""Forces on the chain of units: wheels with their spin, slip, drive and brakes, and what acts on the bodies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import casadi as ca

from vehicle.combination.actuators import drive_torque
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Input, State, Wheel
from vehicle.combination.multibody import Speeds, Vector, acceleration, along, from_unit, levers_to, velocity
from vehicle.combination.unit import Axle
from vehicle.tyres import (
    Contact,
    Num,
    Planar,
    carcass,
    contact,
    rolling_speed,
)

_BRAKE_WINDUP: Final = 0.02  # angle over which a brake's holding torque builds up [rad]: 1 cm at the tread


class WheelState(NamedTuple):
    """States of one wheel, and the quantities that act on it."""

    omega: Num  # spin [rad/s]
    deflection: Planar  # of its tyre, as force over load at the nominal load [-]
    twin: Planar | None  # deflection of the inner contact patch of twin tyres; that above then is the outer one's
    brake_windup: Num  # acting brake torque and rolling drag over the available ones, -1 to 1
    plane: Vector  # direction of its plane along the unit's axes
    hub: Vector  # velocity along the unit's axes [m/s]
    yaw_rate: Num  # of the unit [rad/s]
    travel: Num  # speed of the unit's origin along it, which tells creeping from rolling [m/s]
    load: Num  # [N]
    friction: Num  # [-]
    acceleration: Num  # demanded of drive torques [m/s2]
    slowing: Num  # rate of the spin that its brakes can cause, not above 0 [rad/s2]
    gear: Num  # +1 drives forward, -1 backward
    torque: Num | None = None  # of a further drive, + forward [N m]


class Relaxation(NamedTuple):
    """Relaxation rate of each state of a wheel with the others held [1/s]: minus the Jacobian's diagonal."""

    omega: Num
    deflection: Num  # in either direction; along the wheel damping makes it slower, which the integrator may ignore
    brake_windup: Num
    twin: Num | None  # the inner patch's, as of ``deflection``


class WheelMotion(NamedTuple):
    """Rates of a wheel's states, the ground's action on its unit, and outputs."""

    travel: Num  # magnitude of the velocity along its plane [m/s]
    omega: Num  # [rad/s2]
    deflection: Planar  # [1/s]
    brake_windup: Num  # [1/s]
    twin: Planar | None  # [1/s]
    relaxation: Relaxation
    force: Vector  # at the wheel's centre, along the unit's axes [N]
    moment_opposing: Num  # aligning moment, and that of scrubbing twin tyres, clockwise [N m]
    slip_angle: Num  # [rad]
    friction_used: Num  # horizontal force over the largest one of the tyre law [-]


def wheel_plane(axle: Axle, y: float, delta: Num) -> Vector:
    """Direction of the wheel y [m] to the left of the axle's middle, whose own angle is ``delta`` [rad].

    The wheels' axes meet at ``ackermann_x``: tan = t / (1 - y t / (x - ackermann_x)), with t = tan(delta).
    """
    if axle.ackermann_x is None:
        return Vector(ca.cos(delta), ca.sin(delta))
    t = ca.tan(delta)
    run = 1.0 - (y / (axle.x - axle.ackermann_x)) * t
    per_length = 1.0 / ca.sqrt(run * run + t * t)
    return Vector(per_length * run, per_length * t)


class _Patch(NamedTuple):
    """A contact patch of a wheel."""

    rate: Planar  # of its deflection [1/s]
    decay: Num  # [1/s]
    force: Planar  # [N]
    spin_relaxation: Num  # its part of the wheel's [1/s]
    trail: Num  # [m]
    used: Num  # force over the largest one [-]


def wheel_motion(vehicle: Vehicle, wheel: Wheel, s: WheelState) -> WheelMotion:
    """Motion of a wheel in a state."""
    v = along(s.plane, s.hub)
    turning = (1.0 / _BRAKE_WINDUP) * s.omega
    winding = ca.fabs(turning)  # rate at which the windup of a brake follows the wheel [1/s]
    scrub: Num = 0.0
    if s.twin is None:
        outer, inner = _patch(wheel, s, s.deflection, v, 1.0), None
        force, used, spin, trail = outer.force, outer.used, outer.spin_relaxation, outer.trail
    else:
        reach = wheel.side * 0.5 * _spacing(wheel.axle)  # of the outer patch to the left of the wheel's middle [m]
        outer = _patch(wheel, s, s.deflection, Vector(v.x - reach * s.yaw_rate, v.y), 0.5)
        inner = _patch(wheel, s, s.twin, Vector(v.x + reach * s.yaw_rate, v.y), 0.5)
        force = Planar(outer.force.x + inner.force.x, outer.force.y + inner.force.y)
        scrub = reach * (outer.force.x - inner.force.x)
        used, spin = ca.fmax(outer.used, inner.used), outer.spin_relaxation + inner.spin_relaxation
        trail = 0.5 * (outer.trail + inner.trail)
    spin_rate = _braked_spin_rate(wheel, s, force.x)
    if wheel.axle.driven:
        drive = drive_torque(vehicle, wheel, s.acceleration, s.gear, s.omega, v.x)
        spin_rate = spin_rate + (1.0 / wheel.axle.wheel_inertia) * drive.torque
        spin = spin + (1.0 / wheel.axle.wheel_inertia) * drive.per_spin
    if s.torque is not None:
        spin_rate = spin_rate + (1.0 / wheel.axle.wheel_inertia) * s.torque
    return WheelMotion(
        travel=ca.fabs(v.x),
        omega=spin_rate,
        deflection=outer.rate,
        brake_windup=turning - winding * s.brake_windup,
        twin=None if inner is None else inner.rate,
        relaxation=Relaxation(spin, outer.decay, winding, None if inner is None else inner.decay),
        force=from_unit(s.plane, Vector(force.x, force.y)),
        moment_opposing=scrub + trail * s.brake_windup * force.y,
        slip_angle=ca.atan(v.y / rolling_speed(v.x)),
        friction_used=used,
    )


def _spacing(axle: Axle) -> float:
    return 0.0 if axle.twin_spacing is None else axle.twin_spacing


def _patch(wheel: Wheel, s: WheelState, deflection: Planar, v: Vector, share: float) -> _Patch:
    """Contact patch that moves at v [m/s] along and across the wheel's plane and carries a share of its load."""
    axle, tyre = wheel.axle, wheel.axle.tyre
    sliding = tyre.sliding_rate(axle.wheel_radius * s.omega - v.x, v.y)
    grip = tyre.grip(s.load, s.friction, sliding, ca.fabs(v.x))  # tyre data are those of both twins
    moving = carcass(deflection, sliding, grip.decay, tyre.damping, s.travel)
    load = s.load if share == 1.0 else share * s.load
    on = contact(moving.felt, load, grip)
    return _Patch(
        rate=moving.rate,
        decay=grip.decay,
        force=on.force,
        spin_relaxation=_spin_relaxation(axle, on, moving.at_once),
        trail=grip.trail,
        used=ca.sqrt(on.force.x**2 + on.force.y**2) / (grip.limit * load),
    )


def _braked_spin_rate(wheel: Wheel, s: WheelState, pull: Num) -> Num:
    """Rate of the spin [rad/s2] under brakes, rolling drag, and the ground's pull [N]."""
    radius, per_inertia = wheel.axle.wheel_radius, 1.0 / wheel.axle.wheel_inertia
    per_torque = radius * per_inertia
    resisting = s.slowing - (wheel.axle.tyre.rolling_resistance * per_torque) * s.load
    return resisting * s.brake_windup - per_torque * pull


def _spin_relaxation(axle: Axle, on: Contact, at_once: Num) -> Num:
    """Rate at which the carcass's damping slows a wheel [1/s]; ``at_once`` is that of ``Carcass`` [s].

    The force of a sliding tyre keeps its magnitude and only turns, so the part along the wheel's share of the friction
    circle drops out. Exact for a tyre that sticks and for one that slides completely.
    """
    tyre = axle.tyre
    per_spin = axle.wheel_radius**2 * tyre.nominal_stiffness.x / (axle.wheel_inertia * tyre.relaxation_length)
    return (per_spin * at_once) * (on.per_deflection * (1.0 - on.use_along))


class GroundForce(NamedTuple):
    """Action of the ground on a unit."""

    force: Vector  # of its tyres, along the tractor's axes [N]
    moment: Num  # of its tyres, about its centre of gravity [N m]
    sides: list[Num]  # of each axle's tyres, along the unit's y axis [N]
    gravity: Vector  # along the ground, along the tractor's axes [m/s2]


def course_of(s: State[ca.SX]) -> Vector:
    """Direction of the tractor's x axis in W."""
    return Vector(ca.cos(s.psi[0]), ca.sin(s.psi[0]))


def ground_forces(
    vehicle: Vehicle,
    layout: tuple[Wheel, ...],
    e: list[Vector],
    rolling: list[WheelMotion],
    s: State[ca.SX],
    u: Input[ca.SX],
) -> list[GroundForce]:
    """Action of the ground on each unit."""
    course = course_of(s)
    axles = list(zip(layout[::2], rolling[::2], rolling[1::2], strict=True))
    forces = []
    for i, unit in enumerate(vehicle.units):
        force = Vector(0.0, 0.0)
        moment: Num = 0.0
        sides: list[Num] = []
        for axle, left, right in (one for one in axles if one[0].unit == i):
            across = left.force.y + right.force.y
            turning = (axle.axle.x - unit.cg_x) * across + axle.y * (right.force.x - left.force.x)
            moment = moment + (turning - (left.moment_opposing + right.moment_opposing))
            force = Vector(force.x + (left.force.x + right.force.x), force.y + across)
            sides.append(across)
        gravity = along(course, Vector(u.gravity_x[i], u.gravity_y[i]))
        forces.append(GroundForce(from_unit(e[i], force), moment, sides, gravity))
    return forces


def specific_forces(
    vehicle: Vehicle, e: list[Vector], speeds: Speeds, rates: Speeds, ground: list[GroundForce]
) -> list[Vector]:
    """Acceleration less gravity at each centre of gravity, along the tractor's axes [m/s2]."""
    specific = []
    for i, unit in enumerate(vehicle.units):
        a = acceleration(levers_to(vehicle, i, unit.cg_x), e, speeds, rates)
        specific.append(Vector(a.x - ground[i].gravity.x, a.y - ground[i].gravity.y))
    return specific


def hitch_forces(
    vehicle: Vehicle, e: list[Vector], specific: list[Vector], ground: list[GroundForce], winds: list[Num]
) -> list[Vector]:
    """Force at the front hitch of each towed unit, along its axes [N], from the balance of the units behind it."""
    forces: list[Vector] = []
    behind = Vector(0.0, 0.0)
    for i in reversed(range(1, len(vehicle.units))):
        mass, tyres = vehicle.units[i].mass, ground[i].force
        behind = Vector(
            mass * specific[i].x - tyres.x + behind.x,
            mass * specific[i].y - tyres.y + behind.y,
        )
        if vehicle.exposed:
            push = from_unit(e[i], Vector(0.0, winds[i]))
            behind = Vector(behind.x - push.x, behind.y - push.y)
        forces.insert(0, along(e[i], behind))
    return forces


_DENSITY: Final = 1.2  # of air [kg/m3], 20 degrees Celsius at sea level
_CALM: Final = 1e-6  # square of a speed [m2/s2]: keeps the root's slope finite


def side_forces(vehicle: Vehicle, e: Sequence[Vector], speeds: Speeds, wind: Sequence[Vector]) -> list[Num]:
    """Force of the wind on each unit, along its y axis [N]; ``wind`` is its velocity at each unit along T [m/s]."""
    forces: list[Num] = []
    for i, unit in enumerate(vehicle.units):
        body = unit.side_wind
        if body is None:
            forces.append(0.0)
            continue
        own = velocity(levers_to(vehicle, i, body.x), e, speeds)
        flow = along(e[i], Vector(wind[i].x - own.x, wind[i].y - own.y))
        magnitude = ca.sqrt(flow.x**2 + flow.y**2 + _CALM)
        forces.append((0.5 * _DENSITY * body.area * body.coefficient) * (magnitude * flow.y))
    return forces
