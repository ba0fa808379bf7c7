"""Functions run without a compiler: in numpy for many vehicles, or on CasADi's virtual machine.

Vehicles are split into blocks whose intermediate values stay in the processor's cache; rows of values that are no
longer needed are reused.
"""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from vehicle.engine.program import Constant, Entry, Operation, Tape, TapeProgram
from vehicle.frames import FloatArray


def _minimum(a: Any, b: Any, out: FloatArray) -> None:
    np.minimum(a, b, out=out)  # these two functions need it by name


def _maximum(a: Any, b: Any, out: FloatArray) -> None:
    np.maximum(a, b, out=out)


def _if_else_zero(condition: Any, value: Any, out: FloatArray) -> None:
    out[...] = np.where(condition != 0.0, value, 0.0)


INTO: Final[dict[str, Callable[..., Any]]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "inv": np.reciprocal,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "exp": np.exp,
    "log": np.log,
    "abs": np.absolute,
    "sign": np.sign,
    "floor": np.floor,
    "ceil": np.ceil,
    "not": np.logical_not,
    "pow": np.power,
    "atan2": np.arctan2,
    "hypot": np.hypot,
    "copysign": np.copysign,
    "min": _minimum,
    "max": _maximum,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "if_else_zero": _if_else_zero,
}


def evaluated(tape: Tape, arguments: list[FloatArray]) -> FloatArray:
    """Result (..., n) of a tape for arguments (..., size), node by node; for single evaluations."""
    shape = np.broadcast_shapes(*(a.shape[:-1] for a in arguments))
    values: list[FloatArray] = []
    for node in tape.nodes:
        value = np.empty(shape)
        if isinstance(node, Entry):
            value[...] = arguments[node.argument][..., node.place]
        elif isinstance(node, Constant):
            value[...] = node.value
        else:
            INTO[node.name](*(values[a] for a in node.operands), value)
        values.append(value)
    return np.stack([values[k] for k in tape.result], axis=-1) if tape.result else np.empty((*shape, 0))


class Rows(NamedTuple):
    """Memory row of every operation of a tape: in the result if it belongs there, else in the work space."""

    in_result: dict[int, int]  # node -> row of the result
    in_work: dict[int, int]  # node -> row of the work space
    n_work: int  # rows of the work space


def rows(tape: Tape) -> Rows:
    """Assign rows to the values of a tape: an operation overwrites an operand that is not read again."""
    in_result = {k: i for i, k in reversed(list(enumerate(tape.result))) if isinstance(tape.nodes[k], Operation)}
    last_read = {a: k for k, node in enumerate(tape.nodes) if isinstance(node, Operation) for a in node.operands}
    in_work: dict[int, int] = {}
    free: list[int] = []
    n_work = 0
    for k, node in enumerate(tape.nodes):
        if isinstance(node, Operation):
            free.extend(in_work[a] for a in set(node.operands) if a in in_work and last_read[a] == k)
            if k not in in_result:
                if not free:
                    free.append(n_work)
                    n_work += 1
                in_work[k] = free.pop()  # the last one freed is the likeliest in the cache
    return Rows(in_result, in_work, n_work)


_BLOCK: Final = 1024  # vehicles: a numpy call costs as much as the arithmetic of some 500 numbers


class NumpyMany:
    """Program for n vehicles with these numbers: (n_numbers,) for all, or (n, n_numbers) with a row for each."""

    def __init__(self, program: TapeProgram, numbers: FloatArray, n: int) -> None:
        edges = np.linspace(0, n, -(-n // _BLOCK) + 1).astype(int)
        self._spans = [slice(start, stop) for start, stop in pairwise(edges)]
        self._blocks = [
            _NumpyBlock(program, numbers if numbers.ndim == 1 else numbers[span], span.stop - span.start)
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


class _NumpyBlock:
    """The memory of a block of vehicles, one to a column, and the calls that work on it."""

    def __init__(self, program: TapeProgram, numbers: FloatArray, n: int) -> None:
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


class CasadiOne:
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
