"""Programs in numpy for many vehicles: every operation is one call on a row of vehicles.

Vehicles are split into blocks whose intermediate values stay in the processor's cache; rows of values that are no
longer needed are reused.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, Final

import numpy as np

from vehicle.engine.arithmetic import INTO
from vehicle.engine.program import Program
from vehicle.engine.rows import rows
from vehicle.engine.tape import Constant, Entry, Tape
from vehicle.frames import FloatArray

_BLOCK: Final = 1024  # vehicles: a numpy call costs as much as the arithmetic of some 500 numbers


class Blocks:
    """Program for n vehicles with these numbers: (n_numbers,) for all, or (n, n_numbers) with a row for each."""

    def __init__(self, program: Program, numbers: FloatArray, n: int) -> None:
        edges = np.linspace(0, n, -(-n // _BLOCK) + 1).astype(int)
        self._spans = [slice(start, stop) for start, stop in pairwise(edges)]
        self._blocks = [
            _Block(program, numbers if numbers.ndim == 1 else numbers[span], span.stop - span.start)
            for span in self._spans
        ]
        self._n_result = program.n_result

    def __call__(self, x: FloatArray, u: FloatArray, ticks: int = 1) -> FloatArray:
        """The result (n, n_result) after some ticks from states x (n, n_state) under inputs u (n, n_input)."""
        result = np.empty((len(x), self._n_result))
        with np.errstate(all="ignore"):  # a diverged vehicle is recognised by its state
            for span, block in zip(self._spans, self._blocks, strict=True):
                result[span] = block.run(x[span].T, u[span].T, ticks).T
        return result


class _Block:
    """The memory of a block of vehicles, one to a column, and the calls that work on it."""

    def __init__(self, program: Program, numbers: FloatArray, n: int) -> None:
        self._x = np.empty((program.n_state, n))
        self._u = np.empty((program.n_input, n))
        self._hold: list[Callable[[], Any]] = []
        self._tick: list[Callable[[], Any]] = []
        of_vehicles = np.ascontiguousarray(numbers.T)  # its entries: one number, or a row of them
        own = [of_vehicles[place] for place in program.numbers_of]
        held = [np.empty((len(part.held.result), n)) for part in program.parts]
        for part, c, h in zip(program.parts, own, held, strict=True):
            results = [np.empty((size, 0)) for size in part.numbers.sizes[3:]]
            self._hold += _calls(part.held, [self._x, self._u, np.empty((0, n)), *results, c], h)
        values = [self._x]
        for call in program.calls:
            part, results = program.parts[call.part], [values[k] for k in call.results]
            values.append(np.empty((len(part.body.result), n)))
            arguments = [values[call.state], self._u, np.empty((0, n)), *results, own[call.part], held[call.part]]
            self._tick += _calls(part.body, arguments, values[-1])
        self._result = values[-1]

    def run(self, x: FloatArray, u: FloatArray, ticks: int) -> FloatArray:
        self._x[:] = x
        self._u[:] = u
        for call in self._hold:
            call()
        for tick in range(ticks):
            if tick > 0:
                self._x[:] = self._result
            for call in self._tick:
                call()
        return self._result


def _calls(tape: Tape, arguments: list[FloatArray], result: FloatArray) -> list[Callable[[], Any]]:
    """The tape as calls on its arguments' rows, with the last ones leaving the result."""
    memory = rows(tape)
    work = list(np.empty((memory.n_work, result.shape[1])))  # one view of each row: thousands would fill the cache
    values: list[FloatArray] = []
    calls: list[Callable[[], Any]] = []
    for k, node in enumerate(tape.nodes):
        if isinstance(node, Constant):
            values.append(np.array(node.value))
        elif isinstance(node, Entry):
            values.append(arguments[node.argument][node.place, ...])
        else:
            values.append(result[memory.in_result[k]] if k in memory.in_result else work[memory.in_work[k]])
            calls.append(partial(INTO[node.name], *(values[a] for a in node.operands), values[k]))
    elsewhere = [(i, k) for i, k in enumerate(tape.result) if memory.in_result.get(k) != i]
    return [*calls, *(partial(np.copyto, result[i], values[k]) for i, k in elsewhere)]
