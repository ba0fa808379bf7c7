"""Semi-implicit integrator for systems whose stiff terms lie on known places of the Jacobian's diagonal.

A Rosenbrock W-method of two stages: second order for any approximation A of the Jacobian J, and stable for fast modes
that A contains. Here A is diagonal, so no system of equations is solved. With S = 1 / (1 - g h A)
    k_1 = S f(x),  k_2 = S (f(x + h k_1 / 2) - k_1),  x + h (k_1 + k_2):
up to h^2, k_1 = f + g h A f and k_2 = h J f / 2 - g h A f, whatever A is. Where A is 0 this is the midpoint rule.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from typing import Any, Final

import casadi as ca
import numpy as np

_GAMMA: Final = 1.0 - 1.0 / math.sqrt(2.0)  # L-stable if the Jacobian is that diagonal


def semi_implicit_step(
    rate: Callable[[ca.SX], ca.SX],
    x: ca.SX,
    h: float,
    stiff: ca.SX | Iterable[tuple[int, int]],
    sampled: Collection[int] = (),
) -> ca.SX:
    """State after one step of h [s] from x.

    ``stiff`` is the relaxation rate of every state with the others held [1/s], which is minus the diagonal A and not
    negative; or ranges (start, stop) of states that do not act on each other's rates, for which A is exact. The states
    ``sampled``, by number, are held over the step and then change at the rate at its start (Euler's rule).
    """
    f_1 = rate(x)
    relaxation = stiff if isinstance(stiff, ca.SX) else -exact_diagonal(f_1, x, stiff)
    steps = [_Step(relaxation[i], h) for i in range(x.numel())]
    halfway = (x[i] if i in sampled else x[i] + step.half * f_1[i] for i, step in enumerate(steps))
    f_2 = rate(ca.vertcat(*halfway))
    return ca.vertcat(
        *(x[i] + h * f_1[i] if i in sampled else step.after(x[i], f_1[i], f_2[i]) for i, step in enumerate(steps))
    )


def step_of_two_calls(rates: Any, h: float, sampled: range = range(0)) -> Any:
    """Function (x, u) -> state after one step of h [s], which calls ``rates`` twice: the same step for interpreters.

    ``rates`` is a function (x, u) -> (rate of x, relaxation rate). An interpreter is faster with a short list of
    operations that it repeats than with one of twice the length, in which processors do not predict the next operation.
    """
    x: Any = ca.MX.sym("x", rates.numel_in(0))
    u: Any = ca.MX.sym("u", rates.numel_in(1))
    f_1, relaxation = rates(x, u)
    step = _Step(relaxation, h)
    halfway, once = x + step.half * f_1, slice(sampled.start, sampled.stop)
    f_2 = rates(_with(halfway, once, x), u)[0]  # with no relaxation, the step of the sampled states is h times this
    return ca.Function("step", [x, u], [step.after(x, f_1, _with(f_2, once, f_1))])


def _with(vector: Any, part: slice, other: Any) -> Any:
    """The vector with a part taken from another one."""
    if part.start == part.stop:
        return vector
    return ca.vertcat(vector[: part.start], other[part], vector[part.stop :])


class _Step:
    """Weights of the two rates of one state, or of all of a vector."""

    def __init__(self, relaxation: ca.SX, h: float) -> None:
        damped = (2.0 * _GAMMA) * relaxation
        self.whole = 2.0 / (2.0 / h + damped)  # h S; written so that CasADi divides only once
        self.half = 0.5 * self.whole
        self.first = self.half * damped  # 1 - S

    def after(self, x: ca.SX, f_1: ca.SX, f_2: ca.SX) -> ca.SX:
        """The state after the step."""
        return x + self.whole * (self.first * f_1 + f_2)


def exact_diagonal(f: ca.SX, x: ca.SX, blocks: Iterable[tuple[int, int]]) -> ca.SX:
    """Diagonal of df/dx inside the blocks, 0 elsewhere; one forward sweep per block."""
    diagonal = ca.SX.zeros(x.numel())
    for start, stop in blocks:
        seed = np.zeros(x.numel())
        seed[start:stop] = 1.0
        sensitivity = ca.jtimes(f, x, ca.DM(seed))
        diagonal[start:stop] = ca.fmin(sensitivity[start:stop], 0.0)  # growing modes stay explicit
    return diagonal
