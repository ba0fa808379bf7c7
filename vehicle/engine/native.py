"""Programs as compiled C: for one vehicle or, with several lanes per number, for many."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, Final

import numpy as np

from vehicle.engine.c_source import c_source
from vehicle.engine.compiler import Compiler, library
from vehicle.engine.program import Program
from vehicle.frames import FloatArray

_ARGUMENTS: Final[list[Any]] = [ctypes.c_long, ctypes.c_long, *[ctypes.c_void_p] * 4]


class NativeOne:
    """Program for one vehicle with these numbers; one per thread, as it owns its memory."""

    def __init__(self, program: Program, numbers: FloatArray, using: Compiler) -> None:
        self._library = _loaded(program, using, "LANES=1")
        self._run = self._library.run
        self._x, self._u = np.empty(program.n_state), np.empty(program.n_input)
        self._result = np.empty(program.n_result)
        self._numbers = np.ascontiguousarray(numbers)
        memory = (self._x, self._u, self._numbers, self._result)
        addresses = [ctypes.c_void_p(array.ctypes.data) for array in memory]  # looking one up takes as long as a tick
        self._ticks = ctypes.c_long(1)
        self._arguments = (ctypes.c_long(1), self._ticks, *addresses)

    def __call__(self, x: FloatArray, u: FloatArray, ticks: int = 1) -> FloatArray:
        """Result after some ticks from state x under input u, a new array."""
        self._x[:] = x
        self._u[:] = u
        self._ticks.value = ticks
        self._run(*self._arguments)
        return self._result.copy()


class NativeMany:
    """Program for many vehicles with these numbers: (n_numbers,) for all, or (n, n_numbers) with a row for each."""

    def __init__(self, program: Program, numbers: FloatArray, using: Compiler) -> None:
        self._library = _loaded(program, using, *(["OWN_NUMBERS"] if numbers.ndim == 2 else []))
        self._run = self._library.run
        self._run.argtypes = _ARGUMENTS
        self._numbers = np.ascontiguousarray(numbers)
        self._n_result = program.n_result

    def __call__(self, x: FloatArray, u: FloatArray, ticks: int = 1) -> FloatArray:
        """The result (n, n_result) after some ticks from states x (n, n_state) under inputs u (n, n_input)."""
        x, u = np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(u, dtype=np.float64)
        result = np.empty((len(x), self._n_result))
        self._run(len(x), ticks, x.ctypes.data, u.ctypes.data, self._numbers.ctypes.data, result.ctypes.data)
        return result


@lru_cache(maxsize=64)
def _loaded(program: Program, using: Compiler, *definitions: str) -> ctypes.CDLL:
    return library(c_source(program), definitions, using)
