"""Optimal control problem of the predictive law, and the reference heading that it tracks.

The cost is a sum of squares over the predicted trailer, each term divided by the size at which it counts as one:

    off-tracking at every step, rates of the demands, differences between the slip of the steered axles, and violations
    of the soft limits: swing of the rear end, distance of the trailer's middle from the path (for kerbs), slip of the
    steered axles beyond the peak of their force.

Angles and rates of the actuators are hard limits. Every call makes one Gauss-Newton step from the previous plan, with
exact derivatives of the simulated prediction: a small dense quadratic program in the rates alone.

A rigid trailer led at the hitch has one degree of freedom, its heading. With the hitch at h the follow point is on the
path if it is at the path's point P at the follow distance from h: the required heading is that of h - P, and near it
the off-tracking is the follow distance times the heading difference. The path behind the hitch is measured; only the
hitch's next second has to be predicted.

A lost estimate has no off-tracking, but it contains the path of the hitch since the odometry began. If the trailer was
nearly straight at that time, its follow point is assumed to have been on the path: the trailer's axis at that time
continues the path to the rear.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np
import scipy

from controllers.trailer import TrailerGeometry
from controllers.trailer_steering.mpc.observer import Reckoned
from controllers.trailer_steering.mpc.trailer_model import STEP, Step, Stepper, TrailerModel
from estimators.estimates import Health, OffTracking
from vehicle.clock import TICK
from vehicle.frames import FloatArray, arc_length

_PIECE: Final = 0.2  # longest chord of a path: 0.4 mm inside of a turn of 12 m radius [m]
_SAME: Final = 1e-6  # points closer together count as one: their distance is rounding [m]
_STRAIGHT: Final = 0.1  # articulation up to which the follow point is assumed on the path, 6 deg [rad]
_LEAST_SPEED: Final = 0.1  # of the first estimate of a path [m/s]


class HitchCourse(NamedTuple):
    """Predicted motion of the hitch over n steps, in the present trailer frame S."""

    speed: float  # [m/s]
    rate: float  # of the direction of travel [rad/s]
    directions: FloatArray  # (n,) of travel at the ends of the steps [rad]
    points: FloatArray  # (n, 2) positions at the ends of the steps [m]


class Reference(NamedTuple):
    """Reference at n steps."""

    headings: FloatArray  # (n,) with the follow point on the path, in S [rad]
    offsets: FloatArray  # (n,) of the path from the middle of hitch and follow point, + left [m]


def hitch_course(direction: float, rate: float, speed: float, step: float, n: int) -> HitchCourse:
    """Motion on a circle from a direction of travel [rad] in n steps of ``step`` [s]."""
    directions: FloatArray = direction + rate * step * np.arange(n + 1, dtype=np.float64)
    middles = 0.5 * (directions[1:] + directions[:-1])
    points = np.cumsum(speed * step * np.column_stack([np.cos(middles), np.sin(middles)]), axis=0)
    return HitchCourse(speed, rate, directions[1:], points)


def denser(path: FloatArray) -> FloatArray:
    """The path (n, 2) with points on a cubic spline between those that are more than ``_PIECE`` apart.

    Chords would lie 1 mm inside of a tight turn. Where estimates were missing, points are metres apart.
    """
    s = arc_length(path)
    apart = np.flatnonzero(np.diff(s, prepend=-1.0) > _SAME)
    path, s = path[apart], s[apart]
    if len(path) < 3:
        return path
    pieces = np.ceil(np.diff(s) / _PIECE).astype(np.intp)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    share = (np.arange(len(first)) - first) / np.repeat(pieces, pieces)
    stations = np.append(np.repeat(s[:-1], pieces) + share * np.repeat(np.diff(s), pieces), s[-1])
    return scipy.interpolate.CubicSpline(s, path)(stations)


def reference(ahead: FloatArray, behind: FloatArray, distance: float) -> Reference | None:
    """Reference for the hitch at ``ahead`` (n, 2), in the order of travel; None if the path is too short.

    ``behind`` (m, 2) is the path so far, newest first, in the same frame, and ``distance`` that of the follow point
    [m].
    """
    n, line = len(ahead), np.concatenate([ahead[::-1], behind])
    apart = line[None, :, :] - ahead[:, None, :]
    later = np.arange(len(line)) < (n - 1 - np.arange(n))[:, None]  # than the step
    away = np.where(later, 0.0, np.hypot(apart[..., 0], apart[..., 1]))
    beyond = np.argmax(away >= distance, axis=1)
    if not beyond.all():
        return None
    rows = np.arange(n)
    to_hitch = -_at_distance(apart[rows, beyond - 1], apart[rows, beyond], distance)
    c, s = to_hitch.T / distance
    x = apart[..., 0] * c[:, None] + apart[..., 1] * s[:, None]
    nearest = np.argmin(np.where(later, np.inf, np.abs(x + 0.5 * distance)), axis=1)
    middle = apart[rows, nearest]
    return Reference(np.arctan2(s, c), middle[:, 1] * c - middle[:, 0] * s)


def _at_distance(near: FloatArray, far: FloatArray, distance: float) -> FloatArray:
    """Points (n, 2) of the chords from ``near`` to ``far`` that lie at the distance [m] from the origin."""
    chord = far - near
    # |near + t chord| = distance, t the root between 0 and 1
    a, b, c = (np.sum(p * q, axis=1) for p, q in ((chord, chord), (near, chord), (near, near)))
    t = (np.sqrt(np.maximum(b**2 - a * (c - distance**2), 0.0)) - b) / a
    points: FloatArray = near + t[:, None] * chord
    return points


class MeasuredPath(NamedTuple):
    """Path of the hitch in an estimate, in the trailer's frame S at its tick."""

    estimate: OffTracking
    interval: float  # since the estimate before [s]
    points: FloatArray  # (n, 2) newest first [m]
    complete: bool  # True if it reaches back to the follow point
    axis: float  # direction of the trailer's axis at the oldest point [rad]
    straight: bool  # True if the trailer was straight there


def with_estimate(
    path: MeasuredPath | None, estimate: OffTracking | None, follow_distance: float
) -> MeasuredPath | None:
    """The path of a new usable estimate, or the one before."""
    if estimate is None or (path is not None and estimate.tick <= path.estimate.tick):
        return path
    points = estimate.path
    complete = bool((points[:, 0] <= -follow_distance).any())
    if len(points) < 2 or (complete and estimate.health is Health.LOST):
        return path
    speed = math.hypot(estimate.v_x, estimate.v_y)
    if path is None or (not complete and len(points) < len(path.estimate.path)):
        if speed < _LEAST_SPEED:
            return path
        interval = float(np.hypot(*points[-1])) / speed
        axis, straight = -estimate.yaw_rate * interval, abs(estimate.hitch_direction) < _STRAIGHT
    else:
        interval = (estimate.tick - path.estimate.tick) * TICK
        axis, straight = path.axis - estimate.yaw_rate * interval, path.straight
    return MeasuredPath(estimate, interval, denser(points), complete, axis, straight)


def path_now(path: MeasuredPath, motion: Reckoned, follow_distance: float) -> FloatArray | None:
    """Points (n, 2) in the present trailer frame S, newest first, with the motion since; None if they are too few."""
    points = np.concatenate([motion.hitch_path, path.points])
    if not path.complete:
        if not path.straight:
            return None
        back = np.array([math.cos(path.axis), math.sin(path.axis)])
        points = np.concatenate([points, points[-1] - np.outer([0.5, 2.0], follow_distance * back)])
    return motion.frame.inverse().apply(points)


BLOCKS: Final = (1, 1, 2, 2, 3, 3, 4, 8)  # steps of constant rates: short at the beginning, which matters most
STEPS: Final = sum(BLOCKS)
_BLOCK_OF: Final = np.repeat(np.arange(len(BLOCKS)), BLOCKS)
_FAST: Final = 5.0  # above it the yaw response to an angle grows with speed [m/s]
_UNEVEN: Final = 0.02  # difference of an axle's slip from the mean of the steered ones that counts as one [rad]
_BREACH: Final = 0.3  # violation of a position limit that counts as one, over that off-tracking: limits come first
_PEAK: Final = 2.5  # slip over friction/stiffness at which truck tyres are near their peak side force [-]


class Limits(NamedTuple):
    """Limits of a plan; the first is hard, as are the rates of the outlook."""

    max_steer: float  # of an actuator [rad]
    tail_swing: float  # distance of the rear end from the path, soft [m]
    cut_in: float  # distance of the trailer's middle from the path, soft [m]


class Sizes(NamedTuple):
    """Sizes at which terms of the cost count as one."""

    off_tracking: float  # [m]
    steer_rate: float  # [rad/s], at low speed


class Outlook(NamedTuple):
    """Initial state and inputs of the prediction."""

    state: FloatArray  # (n_x,)
    max_rates: FloatArray  # (n_actuators,) [rad/s]
    course: HitchCourse
    reference: Reference
    side_pull: float  # as in ``Inputs``, like the rest
    disturbance: float
    friction: float


class _Term(NamedTuple):
    """Residuals and their derivatives by the rates."""

    value: FloatArray  # (n,)
    by_rates: FloatArray  # (n, n_rates)

    def __truediv__(self, size: float) -> "_Term":
        return _Term(self.value / size, self.by_rates / size)

    def beyond(self, limit: float) -> "_Term":
        """Excess over a limit on either side."""
        over = self.value - np.clip(self.value, -limit, limit)
        return _Term(over, np.where(over[:, None] != 0.0, self.by_rates, 0.0))


class _Prediction(NamedTuple):
    """The predicted trailer at every step."""

    hitch_direction: _Term  # (STEPS,)
    slip: list[_Term]  # of the steered axles (n_steered,), a step earlier


class Planner:
    """Plans of one trailer's steering."""

    def __init__(
        self, model: TrailerModel, trailer: TrailerGeometry, rear: float, sizes: Sizes, limits: Limits
    ) -> None:
        """A planner for a trailer with its rear end ``rear`` [m] behind the hitch."""
        self._model, self._follow, self._rear = model, trailer.follow_distance, rear
        self._sizes, self._limits = sizes, limits
        self._step = Stepper(model)
        spans = np.tril(np.ones((len(BLOCKS), len(BLOCKS)))) * (STEP * np.array(BLOCKS, dtype=np.float64))
        self._demands_by_rates = np.kron(spans, np.eye(model.n_actuators))  # at the blocks' ends

    def planned(self, outlook: Outlook, guess: FloatArray) -> FloatArray:
        """Rates (n_blocks, n_actuators) [rad/s] after one Gauss-Newton step from a guess, within the hard limits."""
        limits = np.tile(outlook.max_rates, (len(guess), 1))
        guess = np.clip(guess, -limits, limits)
        terms = list(self._terms(outlook, guess))
        r, J = np.concatenate([term.value for term in terms]), np.concatenate([term.by_rates for term in terms])
        rates = guess.ravel()
        start = np.tile(outlook.state[-self._model.n_actuators :], len(BLOCKS))
        low, high = (side * self._limits.max_steer - start for side in (-1.0, 1.0))
        reach = limits.ravel()
        # in the rates themselves, not in their change, so that a plan is always within its own limits
        H = J.T @ J
        solved = _quadratic_program(rates.size)(
            h=H, g=J.T @ r - H @ rates, a=self._demands_by_rates, lbx=-reach, ubx=reach, lba=low, uba=high, x0=rates
        )
        solution = np.asarray(solved["x"], dtype=np.float64).ravel()
        if not np.isfinite(solution).all():
            return guess
        return np.clip(solution, -reach, reach).reshape(guess.shape)

    def _terms(self, outlook: Outlook, rates: FloatArray) -> Iterator[_Term]:
        """All residuals of the cost over their sizes, times the root of the time step [s]."""
        predicted = self._predicted(outlook, rates)
        hitch, wanted, limits = predicted.hitch_direction, outlook.reference, self._limits
        turned = _Term(outlook.course.directions - hitch.value - wanted.headings, -hitch.by_rates)  # heading error
        off_tracking = _Term(self._follow * turned.value, self._follow * turned.by_rates)
        rear = _Term(self._rear * turned.value, self._rear * turned.by_rates)
        middle = _Term(wanted.offsets + 0.5 * self._follow * turned.value, 0.5 * self._follow * turned.by_rates)
        root = 1.0 / np.sqrt(STEP)
        yield off_tracking / (root * self._sizes.off_tracking)
        breach = root * _BREACH * self._sizes.off_tracking
        yield rear.beyond(limits.tail_swing) / breach
        yield middle.beyond(limits.cut_in) / breach
        peak = _PEAK * outlook.friction / self._model.stiffness
        for slip in predicted.slip:
            mean = _Term(slip.value - slip.value.mean(), slip.by_rates - slip.by_rates.mean(axis=0))
            yield mean / (root * _UNEVEN)
            yield slip.beyond(peak) / (root * _UNEVEN)
        gentle = self._sizes.steer_rate / max(1.0, outlook.course.speed / _FAST)
        weight = np.repeat(np.sqrt(STEP * np.array(BLOCKS)), self._model.n_actuators) / gentle
        yield _Term(weight * rates.ravel(), np.diag(weight))

    def _predicted(self, outlook: Outlook, rates: FloatArray) -> _Prediction:
        """The predicted trailer at these rates, with derivatives."""
        m, n_x = self._model.n_actuators, len(outlook.state)
        state, by_rates = outlook.state, np.zeros((n_x, rates.size))
        directions, sensitivities, slips = [], [], []
        for block in _BLOCK_OF.tolist():
            step = self._step(state, _inputs(outlook, rates[block]))
            slips.append(_Term(step.slip, step.slip_by_state @ by_rates))
            by_rates = _carried(step, by_rates, slice(block * m, (block + 1) * m))
            state = step.state
            directions.append(state[0])
            sensitivities.append(by_rates[0])
        return _Prediction(_Term(np.array(directions), np.array(sensitivities)), slips)


def _inputs(outlook: Outlook, rates: FloatArray) -> FloatArray:
    course = outlook.course
    others = [course.speed, course.rate, outlook.side_pull, outlook.disturbance, outlook.friction]
    return np.concatenate([rates, others])  # in the order of ``Inputs``


def _carried(step: Step, by_rates: FloatArray, own: slice) -> FloatArray:
    """Derivatives of the state by all rates after a step with the rates ``own``."""
    after: FloatArray = step.by_state @ by_rates
    after[:, own] += step.by_rate
    return after


@lru_cache(maxsize=8)
def _quadratic_program(n: int) -> Any:
    """Solver of a dense quadratic program in n rates, with bounds on the rates and on the demands."""
    shape = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(n, n)}
    quiet = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
    return ca.conic("rates", "qrqp", shape, quiet)
