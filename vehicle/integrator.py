"""A semi-implicit integrator for systems whose stiffness sits on known places of the diagonal.

ROS2, a Rosenbrock W-method of two stages: second order for any approximation A of the Jacobian J, and stable for fast
modes that A contains. Here A is the exact diagonal of named blocks, so that no system is solved. The order, up to h^2:
k_1 = f + g h A f and k_2 = -f + h J f - 3 g h A f, hence 1.5 k_1 + 0.5 k_2 = f + h J f / 2, whatever A is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Final

import casadi as ca
import numpy as np

_GAMMA: Final = 1.0 - 1.0 / math.sqrt(2.0)  # L-stable where the diagonal is all there is


def semi_implicit_step(
    rate: Callable[[ca.SX], ca.SX], x: ca.SX, h: float, stiff_blocks: Iterable[tuple[int, int]]
) -> ca.SX:
    """State one step of h [s] after x.

    Each ``stiff_blocks`` entry (start, stop) is a range of states of which none acts on another's rate.
    """
    d = _diagonal(rate(x), x, stiff_blocks)
    scale = 1.0 / (1.0 - _GAMMA * h * d)
    k_1 = scale * rate(x)
    k_2 = scale * (rate(x + h * k_1) - 2.0 * k_1)
    return x + h * (1.5 * k_1 + 0.5 * k_2)


def _diagonal(f: ca.SX, x: ca.SX, blocks: Iterable[tuple[int, int]]) -> ca.SX:
    """The diagonal of df/dx inside the blocks, 0 elsewhere: one forward sweep for a whole block."""
    diagonal = ca.SX.zeros(x.numel())
    for start, stop in blocks:
        seed = np.zeros(x.numel())
        seed[start:stop] = 1.0
        sensitivity = ca.jtimes(f, x, ca.DM(seed))
        diagonal[start:stop] = ca.fmin(sensitivity[start:stop], 0.0)  # growing modes stay explicit
    return diagonal
