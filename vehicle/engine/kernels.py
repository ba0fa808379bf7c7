"""Kernels: functions ready to run for one vehicle or for many, compiled, or interpreted without a compiler.

Vehicles are split into blocks whose intermediate values stay in the processor's cache; rows of values that are no
longer needed are reused.
"""

from collections.abc import Callable
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple, Protocol, TypeAlias, get_args

import casadi as ca
import numpy as np

from vehicle.engine.compiler import Compiler, CompilerError, compiler, engine_name, warn_if_interpreted
from vehicle.engine.function_cache import AnyFunction, Composite, written_out
from vehicle.engine.native import NativeMany, NativeOne
from vehicle.engine.program import OPERATIONS, Constant, Entry, Operation, Tape, TapeProgram, program_of
from vehicle.foundation.user_cache import warn_once
from vehicle.frames import FloatArray


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
            OPERATIONS[node.name].into(*(values[a] for a in node.operands), value)
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
            calls.append(partial(OPERATIONS[node.name].into, *(values[a] for a in node.operands), values[k]))
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


Engine: TypeAlias = Literal["auto", "compiled", "interpreted"]
ENGINES: Final = get_args(Engine)
_NOTHING: Final = np.empty(0)


class Kernel(Protocol):
    """Function of state and input; a result that is a state can be fed back for several ticks."""

    def __call__(self, x: FloatArray, u: FloatArray, ticks: int = 1) -> FloatArray:
        """Result, a new array; for many vehicles every array has a row for each."""


def kernel_for_one(
    function: AnyFunction, numbers: FloatArray, engine: Engine, *, always: FloatArray = _NOTHING
) -> Kernel:
    """Kernel of a function (state, input, numbers) for one vehicle; one per thread, as it owns its memory.

    ``always`` are the last entries of every input if they are constant, which saves an interpreter some operations.

    Raises:
        ValueError: if the engine is unknown, or is "compiled" and there is no compiler.
    """
    native = _native(NativeOne, function, numbers, engine)
    if native is not None:
        return native
    return CasadiOne(_with_numbers(function, tuple(numbers.tolist()), tuple(always.tolist())))


def kernel_for_many(function: AnyFunction, numbers: FloatArray, n: int, engine: Engine) -> Kernel:
    """Kernel for n vehicles, with common numbers (n_numbers,) or with a row for each (n, n_numbers).

    Raises:
        ValueError: as ``kernel_for_one``.
    """
    whole = _written_out(function)  # vectors of vehicles cost more to hand over than their operations to repeat
    native = _native(NativeMany, whole, numbers, engine)
    return native if native is not None else NumpyMany(_program(whole), _own_numbers(whole, numbers), n)


def kernel_for_rows(function: AnyFunction, n: int, engine: Engine) -> Kernel:
    """Kernel of a function (state, input, nothing) for n rows; a single row uses the faster kernel for one.

    Raises:
        ValueError: as ``kernel_for_one``.
    """
    if n > 1:
        return kernel_for_many(function, _NOTHING, n, engine)
    one = kernel_for_one(function, _NOTHING, engine)
    return lambda x, u, ticks=1: one(x[0], u[0], ticks)[None, :]


def _native(
    kind: type[NativeOne | NativeMany], function: AnyFunction, numbers: FloatArray, engine: Engine
) -> Kernel | None:
    """The function in compiled C; None if the engine is interpreted."""
    using = _compiler(engine)
    if using is None:
        return None
    try:
        return kind(_program(function), _own_numbers(function, numbers), using)
    except CompilerError as error:
        _fall_back(engine, error)
        return None


def _compiler(engine: Engine) -> Compiler | None:
    if engine not in ENGINES:
        raise ValueError(f"engine = '{engine}' must be one of {', '.join(ENGINES)}")
    if engine == "interpreted":
        return None
    using = compiler()
    if engine == "compiled" and using is None:
        raise ValueError(f"engine = 'compiled' needs a C compiler, vehicle models are {engine_name()}")
    warn_if_interpreted()
    return using


def _fall_back(engine: Engine, error: CompilerError) -> None:
    if engine == "compiled":
        raise ValueError(f"engine = 'compiled': {error}") from error
    warn_once(f"a vehicle model is interpreted, which takes about 5 times as long as compiled: {error}")


@lru_cache(maxsize=32)
def _program(function: AnyFunction) -> TapeProgram:
    return program_of(function)


_written_out = lru_cache(maxsize=32)(written_out)


def _own_numbers(function: AnyFunction, numbers: FloatArray) -> FloatArray:
    """The numbers that a program derives from a vehicle's numbers, or from the numbers of many, one to a row."""
    if numbers.ndim == 1:
        return _own_numbers_of_one(function, numbers.tobytes())
    return _derived(function, numbers)


@lru_cache(maxsize=64)
def _own_numbers_of_one(function: AnyFunction, numbers: bytes) -> FloatArray:
    """Derived once for all plants of a vehicle; not to be written to."""
    own = _derived(function, np.frombuffer(numbers))
    own.flags.writeable = False
    return own


def _derived(function: AnyFunction, numbers: FloatArray) -> FloatArray:
    parts = _program(function).parts
    with np.errstate(all="ignore"):
        of_parts = [
            evaluated(part.numbers, [*[_NOTHING] * 2, numbers, *[_NOTHING] * (len(part.numbers.sizes) - 3)])
            for part in parts
        ]
    return np.concatenate(of_parts, axis=-1)


@lru_cache(maxsize=32)
def _with_numbers(function: AnyFunction, numbers: tuple[float, ...], always: tuple[float, ...]) -> Any:
    """Function of state and input with a vehicle's numbers, and the last entries of the input, inserted."""

    def inserted(of: Any) -> Any:
        kind: Any = ca.MX if of.is_a("MXFunction") else ca.SX
        x, u, _, *results = (kind.sym("v", of.numel_in(k)) for k in range(of.n_in()))
        known = ca.vertcat(u[: u.numel() - len(always)], *always)
        (value,) = of.call([x, known, ca.DM(numbers), *results], True, False)
        return ca.Function(of.name(), [x, u, *results], [ca.cse(ca.densify(value))])

    if not isinstance(function, Composite):
        return inserted(function)
    x, u = (ca.MX.sym("v", function.numel_in(k)) for k in range(2))
    return ca.Function(function.name, [x, u], [function.shortened().of_functions(inserted).on(x, u)])
