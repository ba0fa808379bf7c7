"""Programs as C: the source, and the compiled library for one vehicle or, in lanes, for many."""

import ctypes
import math
from collections.abc import Iterable
from functools import lru_cache
from importlib import resources
from string import Template
from typing import Any, Final

import numpy as np

from vehicle.engine.compiler import Compiler, library
from vehicle.engine.program import Constant, Entry, Node, ProgramPart, Tape, TapeProgram, with_common_reciprocals
from vehicle.frames import FloatArray

_INFIX: Final = {
    "add": "{} + {}",
    "sub": "{} - {}",
    "mul": "{} * {}",
    "div": "{} / {}",
    "neg": "-{}",
    "inv": "1.0 / {}",
}

# An entry of the numbers c is one for all vehicles or, with OWN_NUMBERS, one for each.
_KERNEL: Final = Template("""
#define NX $nx
#define NU $nu
#define NC $nc
#define NY $ny

#ifdef OWN_NUMBERS
typedef real number;
#define NUMBER(k) c[k]
#else
typedef double number;
#define NUMBER(k) ALL(c[k])
#endif
#define FUNCTION static __attribute__((noinline)) void

$functions

/* columns of a few rows of a matrix; lanes beyond its last row repeat that */
static void load(double *restrict to, const double *restrict from, long row, long rows, int columns) {
  for (int e = 0; e < LANES; e++) {
    const double *source = from + (row + e < rows ? row + e : rows - 1) * columns;
    for (int k = 0; k < columns; k++) to[k * LANES + e] = source[k];
  }
}

static void store(double *restrict to, const double *restrict from, long row, long rows, int columns) {
  for (int e = 0; e < LANES && row + e < rows; e++)
    for (int k = 0; k < columns; k++) to[(row + e) * columns + k] = from[k * LANES + e];
}

/* y (n, NY) after some ticks from x (n, NX), with inputs u (n, NU) and numbers c (NC,) or (n, NC) */
void run(long n, long ticks, const double *x, const double *u, const double *c, double *y) {
  for (long row = 0; row < n; row += LANES) {
    real X[NX + 1], U[NU + 1], Y[NY + 1];
$memory
    load((double *)X, x, row, n, NX);
    load((double *)U, u, row, n, NU);
#ifdef OWN_NUMBERS
    real C[NC + 1];
    load((double *)C, c, row, n, NC);
#else
    const double *C = c;
#endif
$hold
    for (long tick = 0; tick < ticks; tick++) {
$evaluate
#if NX == NY
      memcpy(X, Y, sizeof X);
#endif
    }
    store(y, (double *)Y, row, n, NY);
  }
}
""")


# Of a part: what stays the same from tick to tick, and what it computes at every call, with the results a of others.
_PART: Final = Template("""
FUNCTION hold_$k(const real *restrict u, const number *restrict c, real *restrict h) {
$held
}

FUNCTION evaluate_$k(const real *restrict x, const real *restrict u, const number *restrict c, const real *restrict h,
                     $results real *restrict y) {
$body
}
""")


# Of a part: what it derives from a vehicle's numbers.
_DERIVED: Final = Template("""
FUNCTION derive_$k(const real *restrict p, real *restrict c) {
$derived
}
""")


def numbers_source(program: TapeProgram) -> str:
    """C source of ``derive``: the numbers c of ``run`` from a vehicle's numbers p, for one vehicle.

    It stands behind ``c_source`` in one file, compiled with LANES 1.
    """
    functions = "".join(
        _DERIVED.substitute(k=k, derived=_assignments(part.numbers, ["", "", "p"], "c"))
        for k, part in enumerate(program.parts)
    )
    calls = [f"derive_{k}(p, c + {place.start});" for k, place in enumerate(program.numbers_of)]
    return f"{functions}\nvoid derive(const double *p, double *c) {{\n{_indented(2, calls)}\n}}\n"


def c_source(program: TapeProgram) -> str:
    """C source of the function ``run`` of a program; the macros LANES and OWN_NUMBERS choose its variants."""
    first = [of_part.start for of_part in program.numbers_of]
    last = len(program.calls)
    value = ["X", *(f"R{k}" for k in range(1, last)), "Y"]
    kernel = _KERNEL.substitute(
        nx=program.n_state,
        nu=program.n_input,
        nc=program.n_numbers,
        ny=program.n_result,
        functions="".join(_functions(k, part) for k, part in enumerate(program.parts)),
        memory=_indented(
            4,
            [f"real H{k}[{len(part.held.result)} + 1];" for k, part in enumerate(program.parts)]
            + [f"real {value[k]}[{_length(program, k)} + 1];" for k in range(1, last)],
        ),
        hold=_indented(4, [f"hold_{k}(U, C + {first[k]}, H{k});" for k in range(len(program.parts))]),
        evaluate=_indented(
            6,
            [
                f"evaluate_{call.part}({value[call.state]}, U, C + {first[call.part]}, H{call.part}, "
                f"{''.join(f'{value[r]}, ' for r in call.results)}{value[k]});"
                for k, call in enumerate(program.calls, start=1)
            ],
        ),
    )
    return (resources.files("vehicle.engine") / "lanes.h").read_text(encoding="utf-8") + kernel


def _functions(number: int, part: ProgramPart) -> str:
    """The functions of a part."""
    results = [f"a{k}" for k in range(len(part.numbers.sizes) - 3)]
    names = ["x", "u", "", *results, "c", "h"]
    return _PART.substitute(
        k=number,
        results="".join(f"const real *restrict {name}, " for name in results),
        held=_assignments(part.held, names, "h"),
        body=_assignments(with_common_reciprocals(part.body), names, "y"),
    )


def _length(program: TapeProgram, call: int) -> int:
    """Length of the result of a call, counted from 1."""
    return len(program.parts[program.calls[call - 1].part].body.result)


def _indented(spaces: int, lines: Iterable[str]) -> str:
    return "\n".join(" " * spaces + line for line in lines)


def _assignments(tape: Tape, arguments: list[str], result: str) -> str:
    values = [_value(k, node, arguments) for k, node in enumerate(tape.nodes)]
    return _indented(2, _lines(tape, values, result))


def _lines(tape: Tape, values: list[str], result: str) -> Iterable[str]:
    for k, node in enumerate(tape.nodes):
        if not isinstance(node, Entry | Constant):
            operands = [values[a] for a in node.operands]
            call = f"op_{node.name}({', '.join(operands)})"
            yield f"const real v{k} = {_INFIX[node.name].format(*operands) if node.name in _INFIX else call};"
    for i, k in enumerate(tape.result):
        yield f"{result}[{i}] = {values[k]};"


def _value(k: int, node: Node, arguments: list[str]) -> str:
    if isinstance(node, Constant):
        return f"ALL({_literal(node.value)})"
    if isinstance(node, Entry):
        name = arguments[node.argument]
        return f"NUMBER({node.place})" if name == "c" else f"{name}[{node.place}]"
    return f"v{k}"


def _literal(value: float) -> str:
    if math.isfinite(value):
        return repr(value)
    return "NAN" if math.isnan(value) else f"{'-' if value < 0.0 else ''}INFINITY"


_ARGUMENTS: Final[list[Any]] = [ctypes.c_long, ctypes.c_long, *[ctypes.c_void_p] * 4]


class NativeOne:
    """Program for one vehicle with these numbers; one per thread, as it owns its memory."""

    def __init__(self, program: TapeProgram, numbers: FloatArray, using: Compiler) -> None:
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

    def __init__(self, program: TapeProgram, numbers: FloatArray, using: Compiler) -> None:
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
def _loaded(program: TapeProgram, using: Compiler, *definitions: str) -> ctypes.CDLL:
    return library(c_source(program), definitions, using)
