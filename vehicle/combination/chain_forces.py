"""Forces on the chain of units: wheels with their spin, slip, drive and brakes, and what acts on the bodies."""

from collections.abc import Sequence
from typing import Final, NamedTuple, cast

import casadi as ca

from vehicle.combination.actuators import drive_torque
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Chain, ChainWheel, Input, State
from vehicle.combination.multibody import ZERO, Speeds, Vector, acceleration, along, from_unit, levers_to, velocity
from vehicle.combination.unit import Axle, Unit
from vehicle.tyres import Contact, Num, Planar, carcass, contact, rolling_speed

_BRAKE_WINDUP: Final = 0.02  # angle over which a brake's holding torque builds up [rad]: 1 cm at the tread


class RollingWheel(NamedTuple):
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
    brake_deceleration: Num  # rate of the spin that its brakes can cause, not above 0 [rad/s2]
    gear: Num  # +1 drives forward, -1 backward
    torque: "Num | None" = None  # of a further drive, + forward [N m]
    camber: Num = 0.0  # + top to the right [rad]


class Relaxation(NamedTuple):
    """Relaxation rate of each state of a wheel with the others held [1/s]: minus the Jacobian's diagonal."""

    omega: Num
    deflection: Planar  # along the wheel damping makes it slower, which the integrator may ignore
    brake_windup: Num
    twin: Planar | None  # the inner patch's, as of ``deflection``


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


class _ContactPatch(NamedTuple):
    """A contact patch of a wheel."""

    rate: Planar  # of its deflection [1/s]
    decay: Planar  # [1/s]
    force: Planar  # [N]
    spin_relaxation: Num  # its part of the wheel's [1/s]
    trail: Num  # [m]
    moment: Num  # about the vertical besides that of the side force, + left [N m]
    used: Num  # force over the largest one [-]


def wheel_motion(vehicle: Vehicle, wheel: ChainWheel, s: RollingWheel) -> WheelMotion:
    """Motion of a wheel in a state."""
    v = along(s.plane, s.hub)
    turning = (1.0 / _BRAKE_WINDUP) * s.omega
    winding = ca.fabs(turning)  # rate at which the windup of a brake follows the wheel [1/s]
    scrub: Num = 0.0  # moment clockwise [N m]
    if s.twin is None:
        outer, inner = _patch(wheel, s, s.deflection, v, 1.0), None
        force, used, spin, trail = outer.force, outer.used, outer.spin_relaxation, outer.trail
        scrub = scrub - outer.moment
    else:
        spacing = 0.0 if wheel.axle.twin_spacing is None else wheel.axle.twin_spacing
        reach = wheel.side * 0.5 * spacing  # of the outer patch to the left of the wheel's middle [m]
        outer = _patch(wheel, s, s.deflection, Vector(v.x - reach * s.yaw_rate, v.y), 0.5)
        inner = _patch(wheel, s, s.twin, Vector(v.x + reach * s.yaw_rate, v.y), 0.5)
        force = Planar(outer.force.x + inner.force.x, outer.force.y + inner.force.y)
        scrub = reach * (outer.force.x - inner.force.x) - (outer.moment + inner.moment)
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


def _patch(wheel: ChainWheel, s: RollingWheel, deflection: Planar, v: Vector, share: float) -> _ContactPatch:
    """Contact patch that moves at v [m/s] along and across the wheel's plane and carries a share of its load."""
    axle, tyre = wheel.axle, wheel.axle.tyre.on_wheel(wheel.side, s.camber)
    sliding = tyre.sliding_rate(axle.wheel_radius * s.omega - v.x, v.y)
    grip = tyre.grip(s.load, s.friction, sliding, ca.fabs(v.x))  # tyre data are those of both twins
    moving = carcass(deflection, sliding, grip, tyre.damping, s.travel)
    load = s.load if share == 1.0 else share * s.load
    on = contact(moving.felt, load, grip)
    return _ContactPatch(
        rate=moving.rate,
        decay=grip.decays,
        force=on.force,
        spin_relaxation=_spin_relaxation(axle, on, moving.at_once),
        trail=grip.trail,
        moment=grip.moment if share == 1.0 else share * grip.moment,
        used=ca.sqrt(on.force.x**2 + on.force.y**2) / (grip.limit * load),
    )


def _braked_spin_rate(wheel: ChainWheel, s: RollingWheel, pull: Num) -> Num:
    """Rate of the spin [rad/s2] under brakes, rolling drag, and the ground's pull [N]."""
    radius, per_inertia = wheel.axle.wheel_radius, 1.0 / wheel.axle.wheel_inertia
    per_torque = radius * per_inertia
    resisting = s.brake_deceleration - (wheel.axle.tyre.rolling_resistance * per_torque) * s.load
    return resisting * s.brake_windup - per_torque * pull


def _spin_relaxation(axle: Axle, on: Contact, at_once: Num) -> Num:
    """Rate at which the carcass's damping slows a wheel [1/s]; ``at_once`` is that of ``Carcass`` [s].

    The force of a sliding tyre keeps its magnitude and only turns, so the part along the wheel's share of the friction
    circle drops out. Exact for a tyre that sticks and for one that slides completely.
    """
    tyre = axle.tyre
    per_spin = axle.wheel_radius**2 * tyre.nominal_stiffness.x / (axle.wheel_inertia * tyre.relaxation_along)
    return (per_spin * at_once) * (on.per_deflection * (1.0 - on.use_along))


def wheel_motions(
    chain: Chain,
    e: list[Vector],
    speeds: Speeds,
    loads: list[Num],
    brake_decelerations: list[Num],
    s: State[ca.SX],
    u: Input[ca.SX],
) -> list[WheelMotion]:
    """Motion of every wheel, front to rear, left before right."""
    vehicle = chain.vehicle
    origins = [along(e[i], velocity(levers_to(vehicle, i, 0.0), e, speeds)) for i in range(len(chain.units))]
    motions = []
    for k, wheel in enumerate(chain.wheels):
        origin, r = origins[wheel.unit], speeds.yaw_rate[wheel.unit]
        turning = wheel.side * ((0.5 * wheel.axle.track) * r)  # the same product for both sides
        state = RollingWheel(
            omega=s.omega[k],
            deflection=Planar(s.deflection_x[k], s.deflection_y[k]),
            twin=None if wheel.twin is None else Planar(s.twin_x[wheel.twin], s.twin_y[wheel.twin]),
            brake_windup=s.brake_windup[k],
            plane=_plane(chain, k, s, u),
            hub=Vector(origin.x - turning, origin.y + wheel.axle.x * r),
            yaw_rate=r,
            travel=origin.x,
            load=loads[k],
            friction=u.friction[k],
            acceleration=s.acceleration,
            brake_deceleration=brake_decelerations[k],
            gear=u.gear,
            torque=0.5 * u.drive_torque[k // 2] if vehicle.has_torque_inputs else None,
            camber=_camber(chain, k, loads),
        )
        motions.append(wheel_motion(vehicle, wheel, state))
    return motions


def _plane(chain: Chain, k: int, s: State[ca.SX], u: Input[ca.SX]) -> Vector:
    """Direction of the plane of wheel number ``k``: turned by its actuator, and by its suspension as the body moves."""
    wheel = chain.wheels[k]
    axle = wheel.axle
    angles: list[Num] = [] if wheel.steer is None else [wheel.steer_ratio * s.steer[wheel.steer]]
    if axle.roll_steer is not None:
        left, right = (k, k + 1) if wheel.side > 0 else (k - 1, k)
        angles.append(axle.roll_steer * (s.roll[wheel.unit] - (1.0 / axle.track) * (u.road[left] - u.road[right])))
    if axle.bump_steer is not None:
        lever = axle.x - chain.units[wheel.unit].cg_x
        body = s.heave[wheel.unit] - lever * s.pitch[wheel.unit] + wheel.y * s.roll[wheel.unit]
        angles.append((wheel.side * axle.bump_steer) * (body - u.road[k]))
    return wheel_plane(axle, wheel.y, sum(angles[1:], angles[0])) if angles else Vector(1.0, 0.0)


def _camber(chain: Chain, k: int, loads: list[Num]) -> Num:
    """Tilt of wheel number ``k`` against the road, + top to the right [rad]: its own, and its axle's on its tyres."""
    wheel = chain.wheels[k]
    own = 0.0 if wheel.axle.camber is None else -wheel.side * wheel.axle.camber
    if chain.springs is None:
        return own
    left, right = (k, k + 1) if wheel.side > 0 else (k - 1, k)
    springs = chain.springs[wheel.unit].axles[wheel.axle_in_unit]
    return own + (0.5 * springs.track / springs.tyres) * (loads[right] - loads[left])


class GroundForce(NamedTuple):
    """Action of the ground on a unit."""

    force: Vector  # of its tyres, along the tractor's axes [N]
    moment: Num  # of its tyres, about its centre of gravity [N m]
    sides: list[Num]  # of each axle's tyres, along the unit's y axis [N]
    gravity: Vector  # along the ground, along the tractor's axes [m/s2]


def heading(s: State[ca.SX]) -> Vector:
    """Direction of the tractor's x axis in W."""
    return Vector(ca.cos(s.psi[0]), ca.sin(s.psi[0]))


def ground_forces(
    chain: Chain, e: list[Vector], wheels: list[WheelMotion], s: State[ca.SX], u: Input[ca.SX]
) -> list[GroundForce]:
    """Action of the ground on each unit."""
    axles = list(zip(chain.axles, wheels[::2], wheels[1::2], strict=True))
    forces = []
    for i, unit in enumerate(chain.units):
        force, moment = ZERO, cast(Num, 0.0)
        sides: list[Num] = []
        for axle, left, right in (one for one in axles if one[0].unit == i):
            of_axle = left.force + right.force
            turning = (axle.axle.x - unit.cg_x) * of_axle.y + axle.y * (right.force.x - left.force.x)
            moment = moment + (turning - (left.moment_opposing + right.moment_opposing))
            force = force + of_axle
            sides.append(of_axle.y)
        gravity = along(heading(s), Vector(u.gravity_x[i], u.gravity_y[i]))
        forces.append(GroundForce(from_unit(e[i], force), moment, sides, gravity))
    return forces


def specific_forces(
    chain: Chain, e: list[Vector], speeds: Speeds, rates: Speeds, ground: list[GroundForce]
) -> list[Vector]:
    """Acceleration less gravity at each centre of gravity, along the tractor's axes [m/s2]."""
    centres = [levers_to(chain.vehicle, i, unit.cg_x) for i, unit in enumerate(chain.units)]
    return [acceleration(levers, e, speeds, rates) - on.gravity for levers, on in zip(centres, ground, strict=True)]


def hitch_forces(
    chain: Chain, e: list[Vector], specific: list[Vector], ground: list[GroundForce], wind: list[Num]
) -> list[Vector]:
    """Force at the front hitch of each towed unit, along its axes [N], from the balance of the units behind it."""
    forces: list[Vector] = []
    behind = ZERO
    for i in reversed(range(1, len(chain.units))):
        behind = specific[i] * chain.units[i].mass - ground[i].force + behind
        behind = behind - from_unit(e[i], Vector(0.0, wind[i]))
        forces.insert(0, along(e[i], behind))
    return forces


_DENSITY: Final = 1.2  # of air [kg/m3], 20 degrees Celsius at sea level
_CALM: Final = 1e-6  # square of a speed [m2/s2]: keeps the root's slope finite


def wind_lever(unit: Unit) -> Num:
    """Distance of the wind pressure's centre ahead of the centre of gravity [m]."""
    return 0.0 if unit.side_wind is None else unit.side_wind.x - unit.cg_x


def wind_forces(chain: Chain, e: Sequence[Vector], speeds: Speeds, s: State[ca.SX], u: Input[ca.SX]) -> list[Num]:
    """Force of the wind on each unit, along its y axis [N]; zeros if the vehicle is not exposed."""
    forces: list[Num] = []
    for i, unit in enumerate(chain.units):
        body = unit.side_wind
        if body is None or not chain.vehicle.exposed:
            forces.append(0.0)
            continue
        wind = along(heading(s), Vector(0.0, u.wind[i]))
        flow = along(e[i], wind - velocity(levers_to(chain.vehicle, i, body.x), e, speeds))
        magnitude = ca.sqrt(flow.x**2 + flow.y**2 + _CALM)
        forces.append((0.5 * _DENSITY * body.area * body.coefficient) * (magnitude * flow.y))
    return forces
