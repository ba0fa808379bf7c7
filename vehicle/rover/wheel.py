"""One wheel of a rover: slip, force of the ground, drive and sinkage.

The force depends on a lagged slip, which is a state: it follows the slip over the relaxation length of the contact. The
state is bounded also for a wheel that slides without rolling. So it can hold a standing rover on a slope, as friction
does, and no equation divides by a speed.

Every function takes numbers or ``casadi.SX``.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import casadi as ca

from vehicle.rover.description import Rover
from vehicle.rover.soil import Soil
from vehicle.rover.terramechanics import GRAVITY, Rolling, soil_force
from vehicle.tyres import Num

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
    """Friction against the slip: a brush model, which slides fully at three times friction over slip stiffness."""
    sliding = ca.fmin(rover.slip_stiffness * slip.size / (3.0 * friction), 1.0)
    per_slip = load * friction * sliding * (3.0 - sliding * (3.0 - sliding)) / slip.size
    drag = rover.rolling_resistance * load * ca.tanh(w.rim / _STANDING)
    F_x = per_slip * slip.x
    return WheelForce(F_x, per_slip * slip.y, rover.radius * (F_x + drag), load)
