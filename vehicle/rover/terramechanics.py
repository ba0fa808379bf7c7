"""A rigid wheel of a rover: forces in loose soil from the stresses under its rim, slip, drive and sinkage.

Wong & Reece 1967 ("Prediction of rigid wheel performance based on the analysis of soil-wheel stresses", J. of
Terramechanics 4) with the lateral shear and the bulldozing of Ishigami et al. 2007 ("Terramechanics-based model for
steering maneuver of planetary exploration rovers on loose soil", J. of Field Robotics 24). The papers themselves were
not read, but public implementations of both. The bulldozing force enters as F_y = F_u + F_s sin(beta): it is 0 for a
wheel that runs straight and complete for one dragged sideways.

A skidding wheel has two zones of shear (Wong & Reece, part II). In front of a transition angle the soil is pushed ahead
and drives the rim; behind it the rim drags over the soil. The transition angle goes from the entry angle (no skid) to
half of it (locked wheel), as in Pavlov & Johnson (robomechanics/3d-terramechanics, 2022).

Angles are measured from the lowest point of the rim, positive towards the entry into the soil. Not modelled: single
grousers (the radius includes them), compaction by a leading wheel (a rear wheel in a rut sinks in as on fresh soil,
which is the worse case), and digging in over time.

The force depends on a lagged slip, which is a state: it follows the slip over the relaxation length of the contact. The
state is bounded also for a wheel that slides without rolling. So it can hold a standing rover on a slope, as friction
does, and no equation divides by a speed.

Every function takes numbers or ``casadi.SX``.
"""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple, Protocol

import casadi as ca

from vehicle.frames import quadrature
from vehicle.rover.description import Rover, Soil
from vehicle.tyres import Num

GRAVITY: Final = 9.81  # [m/s2]
POINTS: Final = 6  # of Gauss's quadrature in each of the two zones: see the test of its error
_LARGEST_SIDE_SLIP: Final = math.pi / 4.0  # limit of the measured shear moduli, from Ishigami [rad]
_TURNING: Final = 0.05  # displacement over modulus over which combined shear changes its direction; assumed [-]
_HEAPING: Final = 0.02  # speed of the centre over that of the rim, below which bulldozing fades; assumed [-]
_LEAST_SINKAGE: Final = 1e-6  # over the radius; keeps the derivatives of the angles finite [-]


class RigidWheel(Protocol):
    """A rigid wheel."""

    @property
    def radius(self) -> float:
        """Radius [m]."""

    @property
    def width(self) -> float:
        """Width [m]."""


class RimMotion(NamedTuple):
    """Velocity of a wheel's centre over the speed of its rim: v / |r omega|."""

    along: Num  # 1: rolling without slip, below 1 driving, above 1 skidding [-]
    across: Num  # + left [-]


class SoilForce(NamedTuple):
    """Force and torque of the soil on a wheel, along its axes (x in the direction of rolling, y left, z up)."""

    F_x: Num  # [N]
    F_y: Num  # [N]
    F_z: Num  # [N]
    torque: Num  # about the axle, against the rotation [N m]


def slip_ratio(along: Num) -> Num:
    """Slip ratio [-]: (r omega - v_x) / r omega driving, / v_x skidding, from ``along`` = v_x / r omega [-]."""
    return ca.if_else(along <= 1.0, 1.0 - along, 1.0 / ca.fmax(along, 1.0) - 1.0)


def soil_force(wheel: RigidWheel, soil: Soil, sinkage: Num, rolling: RimMotion, points: int = POINTS) -> SoilForce:
    """Force of the soil on a wheel that rolls forward at a sinkage [m]; ``points`` are those of the quadrature."""
    contact = _contact(wheel, soil, sinkage, rolling)
    k_x, k_y = _shear_moduli(soil, ca.atan2(ca.fabs(rolling.across), ca.fabs(rolling.along)))
    F_x: Num = 0.0
    F_z: Num = 0.0
    F_u: Num = 0.0  # lateral shear under the rim
    F_s: Num = 0.0  # bulldozing by the side of the wheel
    torque: Num = 0.0
    for theta, weight, sigma in _stressed(soil, contact, points):
        j_x = _sheared_along(contact, theta, rolling) / k_x
        j_y = -contact.radius * (contact.entry - theta) * rolling.across / k_y
        used_x, used_y = _mobilised(soil, j_x, j_y, rolling, theta)
        strength = soil.cohesion + sigma * ca.tan(soil.friction_angle)
        tau_x, tau_y = strength * used_x, strength * used_y
        s, c = ca.sin(theta), ca.cos(theta)
        area = weight * (contact.radius * wheel.width)
        F_x += area * (tau_x * c - sigma * s)
        F_z += area * (tau_x * s + sigma * c)
        F_u += area * tau_y
        torque += area * (contact.radius * tau_x)
        depth = ca.fmax(contact.radius * (c - ca.cos(contact.entry)), 0.0)
        F_s += weight * _bulldozing(soil, depth) * (contact.radius - depth * c)
    speed = ca.sqrt(rolling.along**2 + rolling.across**2 + _HEAPING**2)
    return SoilForce(F_x, F_u - F_s * (rolling.across / speed), F_z, torque)


class _RimContact(NamedTuple):
    """Contact of the rim with the soil."""

    radius: Num  # [m]
    entry: Num  # theta_f [rad]
    leave: Num  # theta_r [rad]
    crest: Num  # theta_m, of the largest pressure [rad]
    transition: Num  # theta_0, between the two zones of shear of a skidding wheel [rad]
    stiffness: Num  # K: pressure over the sinkage in radii to the power of the exponent [Pa]
    exponent: Num  # n [-]


def _contact(wheel: RigidWheel, soil: Soil, sinkage: Num, rolling: RimMotion) -> _RimContact:
    slip = slip_ratio(rolling.along)
    driving, skidding = ca.fmin(ca.fmax(slip, 0.0), 1.0), ca.fmin(slip, 0.0)
    h = ca.fmax(sinkage / wheel.radius, _LEAST_SINKAGE)
    entry = ca.acos(ca.fmax(1.0 - h, 0.0))
    n = soil.exponent + soil.exponent_by_slip * driving - soil.exponent_by_skid * skidding
    return _RimContact(
        radius=wheel.radius,
        entry=entry,
        leave=-ca.acos(ca.fmax(1.0 - soil.exit_ratio * h, 0.0)),
        crest=(soil.crest_at_rest + soil.crest_by_slip * driving) * entry,
        transition=entry * (1.0 + 0.5 * skidding),
        stiffness=_stiffness(wheel, soil, n),
        exponent=n,
    )


def _stiffness(wheel: RigidWheel, soil: Soil, n: Num) -> Num:
    r, b = wheel.radius, wheel.width
    if soil.pressure_law == "bekker":
        return (soil.k_c / b + soil.k_phi) * r**n
    return (soil.cohesion * soil.k_c + soil.density * soil.k_phi * b) * (r / b) ** n


def _stressed(soil: Soil, contact: _RimContact, points: int) -> Iterator[tuple[Num, Num, Num]]:
    """Quadrature points of the rim: angle [rad], weight [rad] and pressure [Pa]; rear zone, then front zone.

    Behind its crest the pressure has the profile of the front zone, stretched over the angle of the rear zone.
    """
    shares, weights = quadrature(points)
    for end in (contact.leave, contact.entry):
        for share, weight in zip(shares.tolist(), weights.tolist(), strict=True):  # 0 at the crest, 1 at the end
            theta = contact.crest + share * (end - contact.crest)
            in_front = contact.crest + share * (contact.entry - contact.crest)
            rise = ca.fmax(ca.cos(in_front) - ca.cos(contact.entry), 1e-12)
            yield theta, weight * ca.fabs(end - contact.crest), contact.stiffness * rise**contact.exponent


def _shear_moduli(soil: Soil, side_slip: Num) -> tuple[Num, Num]:
    beta = ca.fmin(side_slip, _LARGEST_SIDE_SLIP)
    k_x = soil.shear_x + (soil.shear_x_by_angle + soil.shear_x_by_angle_squared * beta) * beta
    return k_x, soil.shear_y + soil.shear_y_by_angle * beta


def _sheared_along(contact: _RimContact, theta: Num, rolling: RimMotion) -> Num:
    """Backward shear displacement of the soil at theta [m].

    In front of the transition it starts and ends at 0; without skid the transition is at the entry.
    """
    f, t = contact.entry, contact.transition
    front = (ca.sin(f) - ca.sin(t)) * (f - theta) / ca.fmax(f - t, 1e-9) - (ca.sin(f) - ca.sin(theta))
    rear = t - theta - rolling.along * (ca.sin(t) - ca.sin(theta))
    return contact.radius * ca.if_else(theta > t, rolling.along * front, rear)


def _mobilised(soil: Soil, j_x: Num, j_y: Num, rolling: RimMotion, theta: Num) -> tuple[Num, Num]:
    """Mobilised shares of the shear strength along and across [-], from displacements over their moduli.

    ``separate`` (Ishigami): each share can reach 1. ``combined`` (Pavlov & Johnson): the length of both displacements
    counts, and the shear has the direction in which the rim slides.
    """
    if soil.shear_law == "separate":
        return _share(j_x), _share(j_y)
    slide_x, slide_y = ca.fabs(1.0 - rolling.along * ca.cos(theta)), ca.fabs(rolling.across)
    total = _share(ca.sqrt(j_x**2 + j_y**2)) / ca.sqrt(slide_x**2 + slide_y**2 + 1e-18)
    return _direction(j_x) * slide_x * total, _direction(j_y) * slide_y * total


def _direction(j: Num) -> Num:
    """Smoothed sign of a displacement over its modulus."""
    return j / ca.sqrt(j**2 + _TURNING**2)


def _share(j: Num) -> Num:
    """Mobilised share of the strength, with the sign of the displacement over its modulus."""
    return ca.sign(j) * (1.0 - ca.exp(-ca.fabs(j)))


def _bulldozing(soil: Soil, depth: Num) -> Num:
    """Bulldozing force per length of the wheel's side [N/m], after Hegedus."""
    phi = soil.friction_angle
    cot = 1.0 / ca.tan(math.pi / 4.0 - 0.5 * phi)
    D_1 = cot + ca.tan(math.pi / 4.0 + 0.5 * phi)
    D_2 = cot + cot**2 * ca.tan(phi)
    return D_1 * (soil.cohesion * depth + 0.5 * D_2 * soil.density * GRAVITY * depth**2)


_LEAST_ROLLING: Final = 1e-3  # rolling over sliding of a contact; a slip of 1000 stands for no rolling at all [-]
_TINY: Final = 1e-9  # keeps the size of a slip differentiable at 0 [-]
_DAMPING: Final = 0.014  # of the sheared ground: 0.3 of critical for a rover that rocks at 44 rad/s; assumed [s]
_SINKING: Final = 0.05  # time to sink in by ``_SINKING_DEPTH``; assumed: short against the time of travel [s]
_SINKING_DEPTH: Final = 0.1  # of the wheel's radius [-]
_STANDING: Final = 0.01  # wheel speed below which the rolling resistance fades out; assumed [m/s]


class WheelState(NamedTuple):
    """State and motion of a wheel."""

    rim: Num  # speed of the rim, + forward [m/s]
    v_x: Num  # of the centre along the heading [m/s]
    v_y: Num  # of the centre across, + left [m/s]
    slip_x: Num  # lagged slip, see ``RoverState``
    slip_y: Num
    sinkage: Num  # [m]


class WheelGround(NamedTuple):
    """Ground under a wheel."""

    soil: Soil | None  # None: firm ground everywhere
    firm: Num  # 1 on firm ground, 0 on soil
    friction: Num  # of firm ground [-]


class WheelForce(NamedTuple):
    """Force of the ground on a wheel."""

    F_x: Num  # along its heading [N]
    F_y: Num  # across, + left [N]
    torque: Num  # about the axle, against the rotation [N m]
    lift: Num  # vertical force of the soil; on firm ground the load [N]


def slip_rate(rover: Rover, w: WheelState) -> tuple[Num, Num]:
    """Rates of the lagged slip [1/s]; its steady value is slip / (1 + size of slip), slip taken over the rim speed."""
    x, y = w.rim - w.v_x, -w.v_y
    speed = ca.fabs(w.rim) + ca.sqrt(x**2 + y**2 + _TINY**2)
    return (x - speed * w.slip_x) / rover.relaxation_length, (y - speed * w.slip_y) / rover.relaxation_length


def ground_force(rover: Rover, ground: WheelGround, w: WheelState, load: Num) -> WheelForce:
    """Force of the ground on a wheel under a load [N]."""
    slip = _damped_slip(rover, w)
    firm = _on_firm_ground(rover, ground.friction, w, slip, load)
    if ground.soil is None:
        return firm
    return _blend(ground.firm, firm, _in_soil(rover, ground.soil, w, slip))


def spin_up(rover: Rover, speed: Num, demand: Num, torque: Num, *, driven: bool) -> Num:
    """Angular acceleration of a wheel [rad/s2] against the ground's torque [N m].

    The drive torque is limited by a line that falls from the stall torque to 0 at the no-load speed; in braking, by the
    stall torque. Without a drive the wheel rolls freely.
    """
    if not driven:
        return -torque / rover.wheel_inertia
    highest = rover.stall_torque * ca.fmax(0.0, ca.fmin(1.0, 1.0 - speed / rover.no_load_speed))
    lowest = -rover.stall_torque * ca.fmax(0.0, ca.fmin(1.0, 1.0 + speed / rover.no_load_speed))
    demanded = torque + rover.wheel_inertia * (demand - speed) / rover.drive_lag
    return (ca.fmax(lowest, ca.fmin(highest, demanded)) - torque) / rover.wheel_inertia


def sinkage_rate(rover: Rover, ground: WheelGround, w: WheelState, load: Num, lift: Num) -> Num:
    """Rate of the sinkage [m/s]: a wheel sinks while the soil's lift is below its load, and rises on firm ground."""
    rising = -w.sinkage / _SINKING
    if ground.soil is None:
        return rising
    per_force = _SINKING_DEPTH * rover.radius / (rover.mass / len(rover.wheels) * GRAVITY * _SINKING)
    return ground.firm * rising + (1.0 - ground.firm) * per_force * (load - lift)


class _Slip(NamedTuple):
    x: Num  # slide along over the rim's speed, + driving [-]
    y: Num  # the same across, + where the wheel goes to the right [-]
    size: Num  # [-]


def _damped_slip(rover: Rover, w: WheelState) -> _Slip:
    """Lagged slip with damping, on which the force depends."""
    rate = slip_rate(rover, w)
    x, y = w.slip_x + _DAMPING * rate[0], w.slip_y + _DAMPING * rate[1]
    size = ca.sqrt(x**2 + y**2 + _TINY**2)
    scale = 1.0 / ca.fmax(1.0 - size, _LEAST_ROLLING)
    return _Slip(x * scale, y * scale, size * scale)


def _in_soil(rover: Rover, soil: Soil, w: WheelState, slip: _Slip) -> WheelForce:
    """Force of soil on a wheel, which enters it on the side it rolls to; at a standstill, on both sides equally.

    A wheel that slides back while it spins forward still enters in front. So a rover on a slope that is too steep for
    its spinning wheels slides back slowly and does not stick in its own pits.
    """
    ahead = soil_force(rover, soil, w.sinkage, RimMotion(1.0 - slip.x, -slip.y))
    back = soil_force(rover, soil, w.sinkage, RimMotion(1.0 + slip.x, -slip.y))
    return _blend(
        0.5 + 0.5 * ca.tanh((w.rim + w.v_x) / (2.0 * _STANDING)),
        WheelForce(ahead.F_x, ahead.F_y, ahead.torque, ahead.F_z),
        WheelForce(-back.F_x, back.F_y, -back.torque, back.F_z),
    )


def _blend(share: Num, one: WheelForce, other: WheelForce) -> WheelForce:
    return WheelForce(*(share * a + (1.0 - share) * b for a, b in zip(one, other, strict=True)))


def _on_firm_ground(rover: Rover, friction: Num, w: WheelState, slip: _Slip, load: Num) -> WheelForce:
    """Friction against the slip: a brush model, which slides fully at three times friction over slip stiffness."""
    sliding = ca.fmin(rover.slip_stiffness * slip.size / (3.0 * friction), 1.0)
    per_slip = load * friction * sliding * (3.0 - sliding * (3.0 - sliding)) / slip.size
    drag = rover.rolling_resistance * load * ca.tanh(w.rim / _STANDING)
    F_x = per_slip * slip.x
    return WheelForce(F_x, per_slip * slip.y, rover.radius * (F_x + drag), load)
