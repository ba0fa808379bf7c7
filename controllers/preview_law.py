"""Preview driver: linear-quadratic design, and equations for floats, arrays and CasADi symbols.

The driver guides one point of the tractor along a path. Its law is that of `preview_design` about the steady turn of
the path's curvature: there the guided point moves along the path, and the axles slip as their forces need. What the
tractor's own motion tells of side forces that the data sheet does not (cross-fall, trailers, less friction) is part of
that steady turn. Angles enter as the steer angles of a rolling tractor, so that large ones are exact, too.

The driver minimises the sum over the coming path of

    (g e)^2 + eta^2 + (T d(steer)/dt)^2

with the offset e of the guided point, the angle eta between its direction of travel and the path, and the rate of the
steer angle. On a tractor that answers at once this is the law "turn towards the path by g per metre of offset"; lags
of steering, tyres and yaw are in the model, so that the loop is damped at any speed without another number. In a steady
turn the cost is zero: no offset remains.

The path ahead is known. Its optimal use is a weighted sum of the curvatures ahead (linear optimal preview, as MacAdam
1981 and Sharp & Valtetsiotis 2001 have it): with the Riccati solution P and the closed loop A - B K, the weight of the
curvature j periods ahead is -(R + B'P B)^-1 B' ((A - B K)')^j P E.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final, Generic, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from controllers.equations import Functions, Num, limited, settled
from controllers.tractor import STATES, TractorGeometry, TractorModel, path_matrices, rolling_matrices, tractor_model
from vehicle.frames import FloatArray

PERIOD: Final = 0.02  # the driver's step [s]
CREEP: Final = 0.2  # below this speed a direction of travel is not a measurement [m/s]
FASTEST: Final = 45.0  # of the designs [m/s]

# Stretches of the path ahead, as times of travel; a stretch counts with its mean curvature [s].
EDGES: Final = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2, 0.26, 0.32, 0.4, 0.5, 0.64, 0.8, 1.0, 1.24, 1.5, 1.8, 2.2, 2.6, 3.0)

_SMOOTHING: Final = 0.02  # T: short against the lags, which bound the loop; it only evens out kinks of the path [s]
# Lag of the side force at the axles up to which the tractor rolls, and from which on it has slip and inertia [s].
_ROLLING_UP_TO: Final = 0.05
_DYNAMIC_FROM: Final = 0.1
_ROLLING: Final = [0, 1, 6]  # its states
_SPEEDS: Final = 24  # of the designs, each 1.24 times the one before


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Gains over speed: those of the states, then the weights of the stretches ahead."""

    table: FloatArray  # (speeds, STATES + stretches), or (designs, speeds, STATES + stretches)

    def at(self, speed: FloatArray, design: NDArray[np.intp] | None = None) -> FloatArray:
        """Gains (n, STATES + stretches) at speeds (n,) [m/s], constant beyond the designs; of one design each."""
        position = np.log(np.fmin(np.fmax(speed, CREEP), FASTEST) / CREEP) * ((_SPEEDS - 1) / math.log(FASTEST / CREEP))
        low = np.minimum(position.astype(np.intp), _SPEEDS - 2)
        share = (position - low)[:, None]
        below, above = (low, low + 1) if design is None else ((design, low), (design, low + 1))
        gains: FloatArray = (1.0 - share) * self.table[below] + share * self.table[above]
        return gains

    def row(self, speed: float) -> list[float]:
        """Gains as of ``at`` for one design at one speed [m/s]."""
        ratio = min(FASTEST, max(CREEP, speed)) / CREEP
        position = float(np.log(ratio)) * ((_SPEEDS - 1) / math.log(FASTEST / CREEP))
        low = min(int(position), _SPEEDS - 2)
        share = position - low
        gains: list[float] = ((1.0 - share) * self.table[low] + share * self.table[low + 1]).tolist()
        return gains


@lru_cache(maxsize=64)
def gains(tractor: TractorGeometry, gain: float) -> Gains:
    """Gains over speed for a turn towards the path of ``gain`` [rad/m] per offset."""
    speeds = np.geomspace(CREEP, FASTEST, _SPEEDS)
    return Gains(np.array([_at_speed(tractor, gain, float(speed)) for speed in speeds]))


def _at_speed(tractor: TractorGeometry, gain: float, speed: float) -> FloatArray:
    """Gains at a speed [m/s]: of a rolling tractor when slow, of one with slip and inertia when fast, else between."""
    model, lag = tractor_model(tractor), max(tractor.actuator_lag, PERIOD)
    yaw_lag = speed / (model.front.stiffness + model.rear.stiffness)  # of the side force at the axles [s]
    share = min(1.0, max(0.0, (yaw_lag - _ROLLING_UP_TO) / (_DYNAMIC_FROM - _ROLLING_UP_TO)))
    gains = np.zeros(STATES + len(EDGES) - 1)
    if share > 0.0:
        direction = np.array([0.0, 1.0, 1.0 / speed, tractor.x_ref / speed, 0.0, 0.0, 0.0])
        gains += share * _optimal(path_matrices(model, tractor, lag, speed), direction, gain)
    if share < 1.0:
        direction = np.array([0.0, 1.0, tractor.x_ref / tractor.wheelbase])
        rolling = _optimal(rolling_matrices(tractor, lag + yaw_lag, speed), direction, gain)
        gains[_ROLLING] += (1.0 - share) * rolling[:3]
        gains[STATES:] += (1.0 - share) * rolling[3:]
    return gains


def _optimal(matrices: tuple[FloatArray, FloatArray, FloatArray], direction: FloatArray, gain: float) -> FloatArray:
    """Gains of the states, and weights of the stretches ahead.

    The first state is the offset, the last one the steer angle; ``direction`` is the output row of eta.
    """
    A, B, _ = matrices
    A_d, B_d, E_d = _sampled(*matrices)
    offset = gain * np.eye(len(B))[0]
    rate, rate_by_demand = _SMOOTHING * A[-1], _SMOOTHING * B[-1]
    Q = np.outer(offset, offset) + np.outer(direction, direction) + np.outer(rate, rate)
    cross, R = rate * rate_by_demand, rate_by_demand**2
    P = scipy.linalg.solve_discrete_are(A_d, B_d[:, None], Q, np.array([[R]]), s=cross[:, None])
    scale = 1.0 / (R + B_d @ P @ B_d)
    K = scale * (B_d @ P @ A_d + cross)
    return np.concatenate([K, _weights(A_d - np.outer(B_d, K), scale * B_d, P @ E_d)])


def _sampled(A: FloatArray, B: FloatArray, E: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Matrices over a period in which demand and curvature are constant."""
    n = len(B)
    held = np.zeros((n + 2, n + 2))
    held[:n] = np.column_stack([A, B, E])
    exact = scipy.linalg.expm(PERIOD * held)
    return exact[:n, :n], exact[:n, n], exact[:n, n + 1]


def _weights(closed: FloatArray, row: FloatArray, costate: FloatArray) -> FloatArray:
    """Weight of the mean curvature of each stretch ahead [rad m]."""
    ends = np.round(np.array(EDGES) / PERIOD).astype(np.intp)
    weights = np.zeros(int(ends[-1]))
    for j in range(len(weights)):
        weights[j] = -row @ costate
        costate = closed.T @ costate
    return np.array([weights[start:end].sum() for start, end in pairwise(ends.tolist())])


GAIN: Final = 0.6  # turn towards the path per lateral error [rad/m]

# Low-pass on unknown side forces: about the lag of a steering, and no quicker than the tyres relax, for at walking pace
# the combination rocks on them hardly damped.
_SIDE_TIME: Final = 0.12  # [s]
_RELAXATIONS: Final = 0.75
SPEED_GAIN: Final = 2.0  # acceleration demand per speed error [1/s]
SPEED_INTEGRAL: Final = 1.0  # [1/s2]: aperiodic with the gain above, also with the lag of a driveline
_MAX_ACCELERATION: Final = 1.5  # comfortable for a standing load [m/s2]
_STEEPEST: Final = 1.2  # direction of travel against the tractor's axis, at most [rad]


class Motion(NamedTuple, Generic[Num]):
    """Motion of the tractor's frame T."""

    v_x: Num  # [m/s]
    v_y: Num  # [m/s]
    yaw_rate: Num  # [rad/s]


class Slips(NamedTuple, Generic[Num]):
    """State of the tyres that the driver remembers."""

    front: Num  # slip angle of the relaxed tyres ahead [rad]
    rear: Num  # behind [rad]
    side: Num  # side force that the model does not know, over the mass [m/s2], + left
    turn: Num  # its moment about To, over the mass [m2/s2]


class OnPath(NamedTuple, Generic[Num]):
    """Place of the guided point on its path."""

    to_path: Num  # lateral distance from the guided point to the path, + left [m]
    heading_error: Num  # of the path against the tractor, between -pi and pi [rad]
    curvature: Num  # there [1/m]
    headings: Sequence[Num]  # of the path at the ends of the stretches ahead, less that at the guided point [rad]


def steer_after(f: Functions[Num], tractor: TractorGeometry, steer: Num, demand: Num, duration: float) -> Num:
    """The tractor's steer angle [rad] ``duration`` [s] after a demand [rad]."""
    return settled(f, steer, demand, duration, lag=tractor.actuator_lag, max_rate=tractor.max_steer_rate)


def travel(f: Functions[Num], guided_point: tuple[Num, Num], now: Motion[Num]) -> Num:
    """Speed of the guided point [m/s], in T [m], over the ground; at creep speed or above."""
    x_ref, y_ref = guided_point
    along, across = f.fmax(now.v_x, CREEP) - y_ref * now.yaw_rate, now.v_y + x_ref * now.yaw_rate
    return f.sqrt(along**2 + across**2)


def slips_after(
    f: Functions[Num],
    tractor: TractorGeometry,
    old: Slips[Num],
    before: Motion[Num],
    now: Motion[Num],
    steer: Num,
    elapsed: float,
) -> Slips[Num]:
    """Slips ``elapsed`` [s] after the motion ``before``; they stay below creep speed.

    Slip relaxes over the tyres' relaxation length. Newton's law then gives the unknown side force and moment.
    """
    model, moves = tractor_model(tractor), f.if_else(now.v_x < CREEP, 0.0, 1.0 if elapsed > 0.0 else 0.0)
    v = f.fmax(now.v_x, CREEP)
    drift, bend, slips = now.v_y / v, now.yaw_rate / v, []
    rolling = _rolling(f, tractor, drift, bend)
    for slip, group in ((old.front, model.front), (old.rear, model.rear)):
        kinematic = drift + group.x * bend - group.steer_ratio * (steer - rolling)
        share = moves * (1.0 - f.exp((-elapsed / group.relaxation_length) * v))
        slips.append(slip + share * (kinematic - slip))
    per_time = 1.0 / elapsed if elapsed > 0.0 else 0.0
    turning = per_time * (now.yaw_rate - before.yaw_rate)
    lateral = per_time * (now.v_y - before.v_y) + 0.5 * (now.v_x + before.v_x) * 0.5 * (now.yaw_rate + before.yaw_rate)
    force_f, force_r = -model.front.stiffness * slips[0], -model.rear.stiffness * slips[1]
    side = lateral + model.mass_x * turning - force_f - force_r
    moment = model.mass_x * lateral + model.second_moment * turning
    turn = (
        moment - model.front.force_x * force_f - model.rear.force_x * force_r + _scrub(model, now.yaw_rate / v, steer)
    )
    relaxing = _RELAXATIONS * model.front.relaxation_length / v
    share = moves * (1.0 - f.exp(-elapsed / f.fmax(relaxing, _SIDE_TIME)))
    return Slips(slips[0], slips[1], old.side + share * (side - old.side), old.turn + share * (turn - old.turn))


def steer_demand(
    f: Functions[Num],
    tractor: TractorGeometry,
    guided_point: tuple[Num, Num],
    on: OnPath[Num],
    now: Motion[Num],
    slips: Slips[Num],
    steer: Num,
    gains: Sequence[Num],
    gain: Num,
) -> Num:
    """Steer angle [rad] that keeps the guided point on the path.

    Args:
        f: functions of the kind of number.
        tractor: to be steered.
        guided_point: in T [m].
        on: place of the guided point.
        now: motion.
        slips: of the tyres.
        steer: angle now [rad].
        gains: of `preview_design` at this speed, (STATES + stretches,).
        gain: turn towards the path per lateral error [rad/m].
    """
    (x_ref, y_ref), model = guided_point, tractor_model(tractor)
    L, v = tractor.wheelbase, f.fmax(now.v_x, CREEP)
    moves = f.if_else(now.v_x > CREEP, 1.0, 0.0)
    drift = moves * now.v_y / v
    # Of the tractor in a steady turn on this curvature, per metre of its own [rad/m]
    turn = travel(f, guided_point, now) / v * on.curvature
    steady = _steady_turn(f, tractor, turn, v, _scrub(model, now.yaw_rate / v, steer), slips)
    straight = 1.0 - L / x_ref
    # Steer angles of a rolling tractor: whose guided point travels along the path, and with the present yaw rate.
    tan_chi = f.tan(limited(f, on.heading_error, _STEEPEST))
    along_path = f.atan(drift + L * (tan_chi - drift) / (x_ref + y_ref * tan_chi)) - straight * drift
    turning = f.atan(L * now.yaw_rate / v)
    along_steady = f.atan(steady.drift + L * turn) - straight * steady.drift
    deviations = (
        -f.atan(gain * on.to_path) / gain,
        -(x_ref / L) * (along_path - along_steady),
        moves * v * (drift - steady.drift),
        moves * (v / L) * (turning - f.atan(L * turn)),
        slips.front - steady.front,
        slips.rear - steady.rear,
        steer - steady.steer,
    )
    demand = steady.steer - sum(gains[k] * deviations[k] for k in range(STATES))
    # Steer per change of the guided point's direction, over that at small angles, L / x_ref, for which the weights are.
    scale = x_ref**2 * (1.0 + tan_chi**2) / ((x_ref + y_ref * tan_chi) ** 2 + (L * tan_chi) ** 2)
    for k, weight in enumerate(gains[STATES:]):
        begins = on.headings[k - 1] if k > 0 else 0.0
        stretch = (EDGES[k + 1] - EDGES[k]) * v  # of the tractor's own way [m]
        demand = demand + scale * weight * ((on.headings[k] - begins) / stretch - turn)
    return limited(f, demand, tractor.max_steer)


def _rolling(f: Functions[Num], tractor: TractorGeometry, drift: Num, turn: Num) -> Num:
    """Large angle of the foremost axle less its tangent [rad]: exact while it rolls."""
    direction = drift + tractor.wheelbase * turn
    return f.atan(direction) - direction


def _scrub(model: TractorModel, turn: Num, steer: Num) -> Num:
    """Moment against the turn [rad/m] by axles of a group that can not all roll, over the mass [m2/s2]."""
    return model.scrub * turn - model.steered_scrub * steer


class _SteadyTurn(NamedTuple, Generic[Num]):
    drift: Num  # v_y of To over the speed [-]
    front: Num  # slip angles [rad]
    rear: Num
    steer: Num  # [rad]


def _steady_turn(
    f: Functions[Num], tractor: TractorGeometry, turn: Num, v: Num, scrub: Num, slips: Slips[Num]
) -> _SteadyTurn[Num]:
    """Steady turn of ``turn`` [rad/m] at the speed v [m/s].

    The axles slip as their forces need: those of inertia, of scrubbing (a moment [m2/s2]), and the unknown ones.
    """
    model = tractor_model(tractor)
    ahead, behind, inertial = model.front, model.rear, v**2 * turn
    side, moment = slips.side - inertial, slips.turn - model.mass_x * inertial - scrub
    lever = ahead.force_x - behind.force_x
    front = (moment - behind.force_x * side) / (ahead.stiffness * lever)
    rear = (ahead.force_x * side - moment) / (behind.stiffness * lever)
    steer = ((ahead.x - behind.x) * turn - (front - rear)) / (ahead.steer_ratio - behind.steer_ratio)
    drift = rear - behind.x * turn + behind.steer_ratio * steer
    return _SteadyTurn(drift, front, rear, steer + _rolling(f, tractor, drift, turn))


def speed_control(f: Functions[Num], integral: Num, error: Num, elapsed: float) -> tuple[Num, Num]:
    """New integral and acceleration demand, both [m/s2], for an ``error`` of the speed [m/s].

    The integral waits while the demand is at its limit.
    """
    candidate = integral + SPEED_INTEGRAL * elapsed * error
    demand = SPEED_GAIN * error + candidate
    integral = f.if_else(f.fabs(demand) <= _MAX_ACCELERATION, candidate, integral)
    return integral, limited(f, demand, _MAX_ACCELERATION)
