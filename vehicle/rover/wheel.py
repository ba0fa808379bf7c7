"""One wheel of a rover: how it slips, what the ground does to it, how its drive turns it, how it sinks in.

The slip that a wheel's force follows is a state, which the way of the contact renews. It is bounded where the wheel
slides without rolling: so it holds a standing rover on a slope as friction does, and nothing is divided by a speed.

Every function takes numbers or ``casadi.SX``.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import casadi as ca

from vehicle.rover.description import Rover
from vehicle.rover.soil import Soil
from vehicle.rover.terramechanics import GRAVITY, Rolling, soil_force
from vehicle.tyres import Num

_LEAST_ROLLING: Final = 1e-3  # of the way of a contact that slides: a slip of 1000 stands for no rolling at all [-]
_TINY: Final = 1e-9  # keeps the size of a slip differentiable at 0 [-]
_DAMPING: Final = 0.014  # of the sheared ground: 0.3 of critical for a rover that rocks on it at 44 rad/s; assumed [s]
_SINKING: Final = 0.05  # in which a wheel sinks in by ``_SINKING_DEPTH``; assumed: short against its way there [s]
_SINKING_DEPTH: Final = 0.1  # of the wheel's radius [-]
_STANDING: Final = 0.01  # speed of a wheel below which what resists its rolling fades; assumed [m/s]


class WheelState(NamedTuple):
    """State and motion of a wheel."""

    rim: Num  # speed of the rim, + forward [m/s]
    v_x: Num  # of the centre along the heading [m/s]
    v_y: Num  # of the centre across, + left [m/s]
    slip_x: Num  # felt slip: see ``RoverState``
    slip_y: Num
    sinkage: Num  # [m]


class Under(NamedTuple):
    """What a wheel stands on."""

    soil: Soil | None  # None: there is none anywhere
    firm: Num  # 1 where the ground does not give way, else 0
    friction: Num  # of firm ground [-]


class WheelForce(NamedTuple):
    """Force of the ground on a wheel."""

    F_x: Num  # along its heading [N]
    F_y: Num  # across, + left [N]
    torque: Num  # about the axle, against the rotation [N m]
    lift: Num  # what soil carries; on firm ground the load [N]


def slip_rate(rover: Rover, w: WheelState) -> tuple[Num, Num]:
    """Rates of the felt slip [1/s]: steady, it is slip / (1 + size of slip), slip over the rim's speed."""
    x, y = w.rim - w.v_x, -w.v_y
    way = ca.fabs(w.rim) + ca.sqrt(x**2 + y**2 + _TINY**2)
    return (x - way * w.slip_x) / rover.relaxation_length, (y - way * w.slip_y) / rover.relaxation_length


def ground_force(rover: Rover, under: Under, w: WheelState, load: Num) -> WheelForce:
    """What the ground does to a wheel under a load [N]."""
    slip = _felt_slip(rover, w)
    firm = _on_firm_ground(rover, under.friction, w, slip, load)
    if under.soil is None:
        return firm
    return _blend(under.firm, firm, _in_soil(rover, under.soil, w, slip))


def spin_up(rover: Rover, speed: Num, demand: Num, torque: Num, *, driven: bool) -> Num:
    """Angular acceleration of a wheel [rad/s2] against the ground's torque [N m].

    A drive has torque up to a line that falls with speed; in braking up to the stall torque. Without a drive the wheel
    rolls freely.
    """
    if not driven:
        return -torque / rover.wheel_inertia
    most = rover.stall_torque * ca.fmax(0.0, ca.fmin(1.0, 1.0 - speed / rover.no_load_speed))
    least = -rover.stall_torque * ca.fmax(0.0, ca.fmin(1.0, 1.0 + speed / rover.no_load_speed))
    wanted = torque + rover.wheel_inertia * (demand - speed) / rover.drive_lag
    return (ca.fmax(least, ca.fmin(most, wanted)) - torque) / rover.wheel_inertia


def sinking(rover: Rover, under: Under, w: WheelState, load: Num, lift: Num) -> Num:
    """Rate of the sinkage [m/s]: a wheel sinks while soil carries less than its load, and comes up on firm ground."""
    rising = -w.sinkage / _SINKING
    if under.soil is None:
        return rising
    per_force = _SINKING_DEPTH * rover.radius / (rover.mass / len(rover.wheels) * GRAVITY * _SINKING)
    return under.firm * rising + (1.0 - under.firm) * per_force * (load - lift)


class _Slip(NamedTuple):
    x: Num  # slide along over the rim's speed, + driving [-]
    y: Num  # the same across, + where the wheel goes to the right [-]
    size: Num  # [-]


def _felt_slip(rover: Rover, w: WheelState) -> _Slip:
    """The slip that the force follows."""
    rate = slip_rate(rover, w)
    x, y = w.slip_x + _DAMPING * rate[0], w.slip_y + _DAMPING * rate[1]
    size = ca.sqrt(x**2 + y**2 + _TINY**2)
    scale = 1.0 / ca.fmax(1.0 - size, _LEAST_ROLLING)
    return _Slip(x * scale, y * scale, size * scale)


def _in_soil(rover: Rover, soil: Soil, w: WheelState, slip: _Slip) -> WheelForce:
    """A wheel enters the soil on the side that it rolls to; one that stands is in it on both sides alike.

    A wheel that is carried back while it spins forward is taken to enter in front all the same: where a slope asks more
    than spinning wheels pull, the rover slides back slowly instead of sticking in its own pits.
    """
    ahead = soil_force(rover, soil, w.sinkage, Rolling(1.0 - slip.x, -slip.y))
    back = soil_force(rover, soil, w.sinkage, Rolling(1.0 + slip.x, -slip.y))
    return _blend(
        0.5 + 0.5 * ca.tanh((w.rim + w.v_x) / (2.0 * _STANDING)),
        WheelForce(ahead.F_x, ahead.F_y, ahead.torque, ahead.F_z),
        WheelForce(-back.F_x, back.F_y, -back.torque, back.F_z),
    )


def _blend(share: Num, one: WheelForce, other: WheelForce) -> WheelForce:
    return WheelForce(*(share * a + (1.0 - share) * b for a, b in zip(one, other, strict=True)))


def _on_firm_ground(rover: Rover, friction: Num, w: WheelState, slip: _Slip, load: Num) -> WheelForce:
    """Friction against the slip, by a brush of bristles that slides at three times the slip of its initial slope."""
    sliding = ca.fmin(rover.slip_stiffness * slip.size / (3.0 * friction), 1.0)
    per_slip = load * friction * sliding * (3.0 - sliding * (3.0 - sliding)) / slip.size
    drag = rover.rolling_resistance * load * ca.tanh(w.rim / _STANDING)
    F_x = per_slip * slip.x
    return WheelForce(F_x, per_slip * slip.y, rover.radius * (F_x + drag), load)
