"""The optimal control problem: rates of the steer demands over the next 1.2 s that keep the follow point on the path.

The cost is a sum of squares over the predicted trailer, each term over the size at which it counts as one:

    off-tracking at every step, rates of the demands, how unlike the steered axles slip, and what goes beyond the soft
    limits: swing of the rear end beside the path, the trailer's middle beside it (a kerb), slip of the steered axles
    past the peak of their force, where more of it is no use.

Angles and rates of the actuators are hard limits. One Gauss-Newton step from the plan before is made every time, on the
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

BLOCKS: Final = (1, 1, 2, 2, 3, 3, 4, 8)  # steps over which the rates are held: the near ones matter most
STEPS: Final = sum(BLOCKS)
_BLOCK_OF: Final = np.repeat(np.arange(len(BLOCKS)), BLOCKS)
_QUICK: Final = 5.0  # [m/s] from which on a trailer yaws the more for an angle the faster it goes
_UNEVEN: Final = 0.02  # slip of an axle beside the mean of the steered ones that counts as one [rad]
_BREACH: Final = 0.3  # of a soft limit of place that counts as one, over the off-tracking that does: limits go first
_PEAK: Final = 2.5  # friction over stiffness, at which truck tyres are near the peak of their side force [-]


class Limits(NamedTuple):
    """What the plan is made for; the first two are hard."""

    max_steer: float  # of an actuator [rad]
    max_rate: float  # [rad/s]
    tail_swing: float  # of the rear end beside the path, soft [m]
    cut_in: float  # of the trailer's middle beside the path, soft [m]


class Sizes(NamedTuple):
    """Where terms of the cost count as one."""

    off_tracking: float  # [m]
    steer_rate: float  # [rad/s], at low speed


class Outlook(NamedTuple):
    """What the prediction starts from and is told."""

    state: FloatArray  # (n_x,)
    course: HitchCourse
    reference: Reference
    side_pull: float  # as in ``Given``, like the rest
    disturbance: float
    friction: float


class _Term(NamedTuple):
    """Residuals and their derivatives by the rates."""

    value: FloatArray  # (n,)
    by_rates: FloatArray  # (n, n_rates)

    def __truediv__(self, size: float) -> _Term:
        return _Term(self.value / size, self.by_rates / size)

    def beyond(self, limit: float) -> _Term:
        """What goes beyond a limit to either side."""
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
        """A planner for the trailer whose rear end is ``rear`` [m] behind the hitch."""
        self._model, self._follow, self._rear = model, trailer.follow_distance, rear
        self._sizes, self._limits = sizes, limits
        self._step = Stepper(model)
        spans = np.tril(np.ones((len(BLOCKS), len(BLOCKS)))) * (STEP * np.array(BLOCKS, dtype=np.float64))
        self._demands_by_rates = np.kron(spans, np.eye(model.n_actuators))  # at the blocks' ends

    def planned(self, outlook: Outlook, guess: FloatArray) -> FloatArray:
        """Rates (n_blocks, n_actuators) [rad/s] one Gauss-Newton step from a guess, within the hard limits."""
        terms = list(self._terms(outlook, guess))
        r, J = np.concatenate([term.value for term in terms]), np.concatenate([term.by_rates for term in terms])
        rates = guess.ravel()
        start = np.tile(outlook.state[-self._model.n_actuators :], len(BLOCKS))
        low, high = (side * self._limits.max_steer - start for side in (-1.0, 1.0))
        reach = np.full(rates.shape, self._limits.max_rate)
        # in the rates themselves, not in their change: then a plan is always within its own limits
        H = J.T @ J
        solved = _quadratic_program(rates.size)(
            h=H, g=J.T @ r - H @ rates, a=self._demands_by_rates, lbx=-reach, ubx=reach, lba=low, uba=high, x0=rates
        )
        better = np.asarray(solved["x"], dtype=np.float64).ravel()
        if not np.isfinite(better).all():
            return guess
        return np.clip(better, -reach, reach).reshape(guess.shape)

    def _terms(self, outlook: Outlook, rates: FloatArray) -> Iterator[_Term]:
        """All residuals of the cost, in units of their sizes, times the root of the time [s] that they stand for."""
        predicted = self._predicted(outlook, rates)
        hitch, wanted, limits = predicted.hitch_direction, outlook.reference, self._limits
        turned = _Term(outlook.course.directions - hitch.value - wanted.headings, -hitch.by_rates)  # off the heading
        off_tracking = _Term(self._follow * turned.value, self._follow * turned.by_rates)
        rear = _Term(self._rear * turned.value, self._rear * turned.by_rates)
        middle = _Term(wanted.beside + 0.5 * self._follow * turned.value, 0.5 * self._follow * turned.by_rates)
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
        gentle = self._sizes.steer_rate / max(1.0, outlook.course.speed / _QUICK)
        weight = np.repeat(np.sqrt(STEP * np.array(BLOCKS)), self._model.n_actuators) / gentle
        yield _Term(weight * rates.ravel(), np.diag(weight))

    def _predicted(self, outlook: Outlook, rates: FloatArray) -> _Prediction:
        """The trailer steered at these rates, and how it depends on them."""
        m, n_x = self._model.n_actuators, len(outlook.state)
        state, by_rates = outlook.state, np.zeros((n_x, rates.size))
        directions, sensitivities, slips = [], [], []
        for block in _BLOCK_OF.tolist():
            step = self._step(state, _given(outlook, rates[block]))
            slips.append(_Term(step.slip, step.slip_by_state @ by_rates))
            by_rates = _carried(step, by_rates, slice(block * m, (block + 1) * m))
            state = step.state
            directions.append(state[0])
            sensitivities.append(by_rates[0])
        return _Prediction(_Term(np.array(directions), np.array(sensitivities)), slips)


def _given(outlook: Outlook, rates: FloatArray) -> FloatArray:
    course = outlook.course
    others = [course.speed, course.rate, outlook.side_pull, outlook.disturbance, outlook.friction]
    return np.concatenate([rates, others])  # in the order of ``Given``


def _carried(step: Step, by_rates: FloatArray, own: slice) -> FloatArray:
    """Derivatives of the state by all rates after a step, over which those of ``own`` acted."""
    after: FloatArray = step.by_state @ by_rates
    after[:, own] += step.by_rate
    return after


@lru_cache(maxsize=8)
def _quadratic_program(n: int) -> Any:
    """Solver of a dense quadratic program in n rates with as many bounds on the demands they add up to."""
    shape = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(n, n)}
    quiet = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
    return ca.conic("rates", "qrqp", shape, quiet)
