"""Functions made ready to run, for one vehicle or for many: compiled, or interpreted where there is no compiler."""

from __future__ import annotations

import logging
from functools import lru_cache
from typing import Any, Final, Literal, Protocol, TypeAlias, get_args

import casadi as ca
import numpy as np

from vehicle.engine.arithmetic import evaluated
from vehicle.engine.blocks import Blocks
from vehicle.engine.compiler import Compiler, CompilerError, compiler
from vehicle.engine.native import NativeMany, NativeOne
from vehicle.engine.program import Program, program_of
from vehicle.engine.virtual import Virtual
from vehicle.frames import FloatArray

_LOG = logging.getLogger(__name__)

Engine: TypeAlias = Literal["auto", "compiled", "interpreted"]
ENGINES: Final = get_args(Engine)
_NOTHING: Final = np.empty(0)


class Kernel(Protocol):
    """A function of state and input whose result, where it is a state, may be fed back for some ticks."""

    def __call__(self, x: FloatArray, u: FloatArray, ticks: int = 1) -> FloatArray:
        """The result, a new array; for many vehicles every array has a row for each."""


def kernel_for_one(function: Any, numbers: FloatArray, engine: Engine, *, always: FloatArray = _NOTHING) -> Kernel:
    """A ``casadi.Function`` (state, input, numbers) for one vehicle, in memory of its own: one per thread.

    Where the last entries of every input are known (``always``), that saves an interpreter some operations.

    Raises:
        ValueError: if the engine is unknown, or must be compiled and can not.
    """
    native = _native(NativeOne, function, numbers, engine)
    return (
        native
        if native is not None
        else Virtual(_with_numbers(function, tuple(numbers.tolist()), tuple(always.tolist())))
    )


def kernel_for_many(function: Any, numbers: FloatArray, n: int, engine: Engine) -> Kernel:
    """The same for n vehicles, of the same numbers (n_numbers,) or each of its own (n, n_numbers).

    Raises:
        ValueError: if the engine is unknown, or must be compiled and can not.
    """
    native = _native(NativeMany, function, numbers, engine)
    return native if native is not None else Blocks(_program(function), _worked_with(function, numbers), n)


def kernel_for_rows(function: Any, n: int, engine: Engine) -> Kernel:
    """A ``casadi.Function`` (state, input, nothing) for n rows; a single row runs as one vehicle, which is faster.

    Raises:
        ValueError: as ``kernel_for_one``.
    """
    if n > 1:
        return kernel_for_many(function, _NOTHING, n, engine)
    one = kernel_for_one(function, _NOTHING, engine)
    return lambda x, u, ticks=1: one(x[0], u[0], ticks)[None, :]


def _native(kind: type[NativeOne | NativeMany], function: Any, numbers: FloatArray, engine: Engine) -> Kernel | None:
    """The function in compiled C; None where the engine does without."""
    using = _compiler(engine)
    if using is None:
        return None
    try:
        return kind(_program(function), _worked_with(function, numbers), using)
    except CompilerError as error:
        _do_without(engine, error)
        return None


def _compiler(engine: Engine) -> Compiler | None:
    if engine not in ENGINES:
        raise ValueError(f"engine = '{engine}' must be one of {', '.join(ENGINES)}")
    if engine == "interpreted":
        return None
    found = compiler()
    if engine == "compiled" and found is None:
        raise ValueError("engine = 'compiled' needs a C compiler: none found, or OFFTRACK_COMPILER says so")
    _LOG.info("engine: %s", "interpreted" if found is None else f"compiled by {found.path}")
    return found


def _do_without(engine: Engine, error: CompilerError) -> None:
    if engine == "compiled":
        raise ValueError(f"engine = 'compiled': {error}") from error
    _LOG.warning("engine: interpreted, for %s", error)


@lru_cache(maxsize=32)
def _program(function: Any) -> Program:
    return program_of(function)


def _worked_with(function: Any, numbers: FloatArray) -> FloatArray:
    """What a program works with of a vehicle's numbers."""
    with np.errstate(all="ignore"):
        return evaluated(_program(function).numbers, [_NOTHING, _NOTHING, numbers])


@lru_cache(maxsize=32)
def _with_numbers(function: Any, numbers: tuple[float, ...], always: tuple[float, ...]) -> Any:
    """The function of state and input that is left once a vehicle's numbers, and the end of the input, are in it."""
    x, u = (ca.SX.sym("v", function.numel_in(k)) for k in range(2))
    known = ca.vertcat(u[: u.numel() - len(always)], *always)
    return ca.Function(function.name(), [x, u], [ca.cse(ca.densify(function(x, known, np.array(numbers))))])
