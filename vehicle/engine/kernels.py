"""Kernels: functions ready to run for one vehicle or for many, compiled, or interpreted without a compiler."""

from functools import lru_cache
from typing import Any, Final, Literal, Protocol, TypeAlias, get_args

import casadi as ca
import numpy as np

from vehicle.engine.compiler import Compiler, CompilerError, compiler, engine_name, warn_if_interpreted, warn_once
from vehicle.engine.function_cache import AnyFunction, Composite, written_out
from vehicle.engine.interpreter import CasadiOne, NumpyMany, evaluated
from vehicle.engine.native import NativeMany, NativeOne
from vehicle.engine.program import TapeProgram, program_of
from vehicle.frames import FloatArray

Engine: TypeAlias = Literal["auto", "compiled", "interpreted"]
ENGINES: Final = get_args(Engine)
_NOTHING: Final = np.empty(0)


class Kernel(Protocol):
    """Function of state and input; a result that is a state can be fed back for several ticks."""

    def __call__(self, x: FloatArray, u: FloatArray, ticks: int = 1) -> FloatArray:
        """Result, a new array; for many vehicles every array has a row for each."""


def kernel_for_one(
    function: AnyFunction,
    numbers: FloatArray,
    engine: Engine,
    *,
    always: FloatArray = _NOTHING,
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
