"""The chain's equations compiled for CasADi's virtual machine: several ticks to a call, no arguments converted."""

from __future__ import annotations

from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
import numpy as np

from vehicle.chain import derivative, output
from vehicle.clock import TICK
from vehicle.description import Vehicle
from vehicle.frames import FloatArray
from vehicle.integrator import semi_implicit_step
from vehicle.layout import Input, State, input_sizes, parts, state_sizes


class Buffered:
    """A compiled function (state, input) -> vector that works in its own memory; one per thread."""

    def __init__(self, function: Any) -> None:
        self._buffer, self._evaluate = function.buffer()
        self._arguments = [np.zeros(function.numel_in(k)) for k in range(2)]
        self._result = np.zeros(function.numel_out(0))
        for k, argument in enumerate(self._arguments):
            self._buffer.set_arg(k, argument.data)
        self._buffer.set_res(0, self._result.data)

    def __call__(self, state: FloatArray, u: FloatArray) -> FloatArray:
        """The result, as a new array."""
        self._arguments[0][:] = state
        self._arguments[1][:] = u
        self._evaluate()
        return self._result.copy()


@lru_cache(maxsize=32)  # vehicles are values: plants of the same one share their compiled functions
def compiled_steps(vehicle: Vehicle, ticks: int) -> Any:
    """Function (state, input) -> state, ``ticks`` ticks later under a held input."""
    one = _compiled_step(vehicle)
    if ticks == 1:
        return one
    x, u = ca.MX.sym("x", one.numel_in(0)), ca.MX.sym("u", one.numel_in(1))
    after = x
    for _ in range(ticks):
        after = one(after, u)
    return ca.Function("steps", [x, u], [after])


@lru_cache(maxsize=8)
def compiled_output(vehicle: Vehicle) -> Any:
    """Function (state, input) -> output."""
    x, u = _symbols(vehicle)
    told = output(vehicle, State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle))))
    return ca.Function("output", [x, u], [ca.vertcat(*told)])


@lru_cache(maxsize=8)
def compiled_derivative(vehicle: Vehicle) -> Any:
    """Function (state, input) -> time derivative of the state."""
    x, u = _symbols(vehicle)
    rate = derivative(vehicle, State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle))))
    return ca.Function("derivative", [x, u], [ca.cse(ca.vertcat(*rate))])


@lru_cache(maxsize=8)
def _compiled_step(vehicle: Vehicle) -> Any:
    x, u = _symbols(vehicle)
    rate = compiled_derivative(vehicle)
    sizes = state_sizes(vehicle)
    spans = State(*pairwise(accumulate(sizes, initial=0)))
    stiff = (spans.omega, spans.deflection_x, spans.deflection_y, spans.brake_windup)
    after = semi_implicit_step(lambda state: rate(state, u), x, TICK, stiff)
    return ca.Function("step", [x, u], [ca.cse(after)])


def _symbols(vehicle: Vehicle) -> tuple[ca.SX, ca.SX]:
    return ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("u", sum(input_sizes(vehicle)))
