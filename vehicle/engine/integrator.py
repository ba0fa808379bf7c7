"""Semi-implicit integrator for systems whose stiff terms lie on known places of the Jacobian's diagonal.

A Rosenbrock W-method of two stages: second order for any approximation A of the Jacobian J, and stable for fast modes
that A contains. Here A is diagonal, so no system of equations is solved. With S = 1 / (1 - g h A)
    k_1 = S f(x),  k_2 = S (f(x + h k_1 / 2) - k_1),  x + h (k_1 + k_2):
up to h^2, k_1 = f + g h A f and k_2 = h J f / 2 - g h A f, whatever A is. Where A is 0 this is the midpoint rule.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, Final

import casadi as ca
import numpy as np

_GAMMA: Final = 1.0 - 1.0 / math.sqrt(2.0)  # L-stable if the Jacobian is that diagonal


def semi_implicit_step(rate: Callable[[ca.SX], ca.SX], x: ca.SX, h: float | ca.SX, relaxation: ca.SX) -> ca.SX:
    """State after one step of h [s] from x.

    ``relaxation`` is the rate of every state with the others held [1/s], which is minus the diagonal A and not
    negative.
    """
    f_1 = rate(x)
    half, damped = half_weight(relaxation, h), damped_rate(relaxation)
    later: ca.SX = after(x, f_1, rate(halfway(x, f_1, half)), damped, half)
    return later


# The step in parts, for numbers or vectors, SX or MX.


def damped_rate(relaxation: Any) -> Any:
    """2 g times the relaxation rate, which is -2 g A [1/s]."""
    return (2.0 * _GAMMA) * relaxation


def half_weight(relaxation: Any, h: float | ca.SX) -> Any:
    """Weight of half a step h [s]: h S / 2 [s]."""
    return 1.0 / (2.0 / h + damped_rate(relaxation))


def halfway(x: Any, f_1: Any, half: Any) -> Any:
    """State x + h k_1 / 2 at which the second rate is taken; ``half`` is the ``half_weight``."""
    return x + half * f_1


def after(x: Any, f_1: Any, f_2: Any, damped: Any, half: Any) -> Any:
    """State x + h (k_1 + k_2) after the step; 1 - S is the ``half_weight`` times the ``damped_rate``."""
    return x + (2.0 * half) * ((half * damped) * f_1 + f_2)


def exact_diagonal(f: ca.SX, x: ca.SX, blocks: Iterable[tuple[int, int]]) -> ca.SX:
    """Diagonal of df/dx inside the blocks (start, stop), 0 elsewhere; one forward sweep per block.

    States of a block must not act on each other's rates.
    """
    diagonal = ca.SX.zeros(x.numel())
    for start, stop in blocks:
        seed = np.zeros(x.numel())
        seed[start:stop] = 1.0
        sensitivity = ca.jtimes(f, x, ca.DM(seed))
        diagonal[start:stop] = ca.fmin(sensitivity[start:stop], 0.0)  # growing modes stay explicit
    return diagonal
