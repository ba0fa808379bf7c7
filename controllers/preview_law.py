"""Equations of the preview driver, written once for floats and for CasADi symbols.

The driver guides one point of the tractor along a path: inverse kinematics of the point's direction of travel, at the
place where the tractor will be when its steering has answered. Slip of both axles, measured in the tractor's own
motion, is compensated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from controllers.actuator import settled
from controllers.functions import Functions, Num, limited

if TYPE_CHECKING:
    from controllers.tractor import TractorGeometry

PERIOD: Final = 0.02  # the driver's step [s]
GAIN: Final = 0.6  # turn towards the path per lateral error [rad/m]
CREEP: Final = 0.3  # below this speed a direction of travel is not a measurement [m/s]

_SLIP_TIME: Final = 0.1  # low-pass on the front axle's slip, at least: shorter than a turn-in [s]
_SLIP_LENGTH: Final = 0.75  # distance of that low-pass: longer than a tyre's relaxation [m]
SPEED_GAIN: Final = 2.0  # acceleration demand per speed error [1/s]
SPEED_INTEGRAL: Final = 1.0  # [1/s2]: aperiodic with the gain above, also with the lag of a driveline
_MAX_ACCELERATION: Final = 1.5  # comfortable for a standing load [m/s2]
_CROSSOVER: Final = 3.0  # of the lateral loop at most: lags of steering, yaw and tyres leave no phase beyond [rad/s]
_STEEPEST: Final = 1.2  # direction of travel against the tractor's axis, at most [rad]


def gain_at(f: Functions[Num], gain: float, speed: Num) -> Num:
    """Turn per lateral error [rad/m] at a set speed [m/s]: an error decays at the rate gain times speed."""
    return f.fmin(gain, _CROSSOVER / speed)


def steer_after(f: Functions[Num], tractor: TractorGeometry, steer: Num, demand: Num, duration: float) -> Num:
    """The tractor's steer angle [rad] ``duration`` [s] after a demand [rad]."""
    return settled(f, steer, demand, duration, lag=tractor.actuator_lag, max_rate=tractor.max_steer_rate)


def filtered_front_slip(
    f: Functions[Num],
    tractor: TractorGeometry,
    slip: Num,
    steer: Num,
    v_x: Num,
    v_y: Num,
    yaw_rate: Num,
    elapsed: float,
) -> Num:
    """Slip angle of the front axle [rad], low-passed over ``elapsed`` [s], from the motion of T [m/s, rad/s]."""
    measured = f.atan2(v_y + tractor.wheelbase * yaw_rate, v_x) - steer
    lag = f.fmax(_SLIP_TIME, _SLIP_LENGTH / f.fmax(v_x, CREEP))
    share = f.if_else(v_x < CREEP, 0.0, 1.0 - f.exp(-elapsed / lag))
    return slip + share * (measured - slip)


def horizon(tractor: TractorGeometry) -> float:
    """Time in which the steering answers a demand [s]."""
    return tractor.actuator_lag + 0.5 * PERIOD


def mean_yaw_rate(f: Functions[Num], tractor: TractorGeometry, steer: Num, demand: Num, v_x: Num, yaw_rate: Num) -> Num:
    """Yaw rate of the tractor [rad/s] in the middle of the `horizon`."""
    halfway = steer_after(f, tractor, steer, demand, 0.5 * horizon(tractor))
    return yaw_rate + v_x * (f.tan(halfway) - f.tan(steer)) / tractor.wheelbase


def steer_demand(
    f: Functions[Num],
    tractor: TractorGeometry,
    *,
    guided_point: tuple[Num, Num],
    heading_error: Num,
    to_path: Num,
    v_x: Num,
    v_y: Num,
    front_slip: Num,
    gain: Num,
) -> Num:
    """Steer angle [rad] that turns the guided point towards the path.

    Args:
        f: functions of the kind of number.
        tractor: to be steered.
        guided_point: in T [m].
        heading_error: of the path against the tractor, between -pi and pi [rad].
        to_path: lateral distance from the guided point to the path, + left [m].
        v_x: speed of T [m/s].
        v_y: lateral speed of T [m/s].
        front_slip: slip angle of the front axle [rad].
        gain: turn towards the path per lateral error [rad/m].
    """
    chi = heading_error + f.atan(gain * to_path)
    # The guided point travels along chi if v_y + r x_ref = (v_x - r y_ref) tan(chi); solved for r / v_x:
    tan_chi = f.tan(limited(f, chi, _STEEPEST))
    drift = f.if_else(v_x > CREEP, v_y / f.fmax(v_x, CREEP), 0.0)
    x_ref, y_ref = guided_point
    curvature = (tan_chi - drift) / (x_ref + y_ref * tan_chi)
    return limited(f, f.atan(drift + tractor.wheelbase * curvature) - front_slip, tractor.max_steer)


def speed_control(f: Functions[Num], integral: Num, error: Num, elapsed: float) -> tuple[Num, Num]:
    """New integral and acceleration demand, both [m/s2], for an ``error`` of the speed [m/s].

    The integral waits while the demand is at its limit.
    """
    candidate = integral + SPEED_INTEGRAL * elapsed * error
    demand = SPEED_GAIN * error + candidate
    integral = f.if_else(f.fabs(demand) <= _MAX_ACCELERATION, candidate, integral)
    return integral, limited(f, demand, _MAX_ACCELERATION)
