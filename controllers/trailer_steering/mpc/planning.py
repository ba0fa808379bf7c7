"""Optimal control problem: rates of the steer demands over the next 1.2 s that keep the follow point on the path.

The cost is a sum of squares over the predicted trailer, each term divided by the size at which it counts as one:

    off-tracking at every step, rates of the demands, differences between the slip of the steered axles, and violations
    of the soft limits: swing of the rear end, distance of the trailer's middle from the path (for kerbs), slip of the
    steered axles beyond the peak of their force.

Angles and rates of the actuators are hard limits. Every call makes one Gauss-Newton step from the previous plan, with
exact derivatives of the simulated prediction: a small dense quadratic program in the rates alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from controllers.trailer import TrailerGeometry
from controllers.trailer_steering.mpc.reference import HitchCourse, Reference
from controllers.trailer_steering.mpc.stepping import STEP, Step, Stepper
from controllers.trailer_steering.mpc.trailer_model import TrailerModel
from vehicle.frames import FloatArray

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

    def __truediv__(self, size: float) -> _Term:
        return _Term(self.value / size, self.by_rates / size)

    def beyond(self, limit: float) -> _Term:
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
