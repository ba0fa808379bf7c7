"""Functions on CasADi's virtual machine, without a compiler and without conversion of arguments."""

from __future__ import annotations

from typing import Any

import numpy as np

from vehicle.frames import FloatArray


class Virtual:
    """A ``casadi.Function`` (state, input) -> result for one vehicle; one per thread, as it owns its memory."""

    def __init__(self, function: Any) -> None:
        self._x, self._u = (np.zeros(function.numel_in(k)) for k in range(2))
        self._result = np.zeros(function.numel_out(0))
        self._buffers: list[Any] = []  # the evaluators do not keep them alive
        self._forward = self._bound(function, self._x, self._result)
        # If the result is a state, the next tick goes from it back into the memory of x.
        self._back: Any = self._bound(function, self._result, self._x) if len(self._x) == len(self._result) else None

    def __call__(self, x: FloatArray, u: FloatArray, ticks: int = 1) -> FloatArray:
        """Result after some ticks from state x under input u, a new array."""
        self._x[:] = x
        self._u[:] = u
        for _ in range(ticks // 2):
            self._forward()
            self._back()
        if ticks % 2 == 0:
            return self._x.copy()
        self._forward()
        return self._result.copy()

    def _bound(self, function: Any, x: FloatArray, result: FloatArray) -> Any:
        buffer, evaluate = function.buffer()
        buffer.set_arg(0, x.data)
        buffer.set_arg(1, self._u.data)
        buffer.set_res(0, result.data)
        self._buffers.append(buffer)
        return evaluate
