"""Every back end computes what CasADi's own machine computes, operation by operation and tick by tick."""

import casadi as ca
import numpy as np
import pytest

from vehicle.engine.compiler import Compiler, compiler
from vehicle.engine.kernels import CasadiOne, NumpyMany, evaluated
from vehicle.engine.native import NativeMany, NativeOne
from vehicle.engine.program import OPERATIONS, Operation, TapeProgram, program_of
from vehicle.frames import FloatArray

x, u, p = ca.SX.sym("x", 3), ca.SX.sym("u", 2), ca.SX.sym("p", 2)
a, b, between = x[0], x[1], ca.tanh(x[2])  # the last one inside (-1, 1)

EVERYTHING = {
    "add": a + b,
    "sub": a - b,
    "mul": a * b,
    "div": a / b,
    "neg": -a,
    "inv": 1.0 / a,
    "sqrt": ca.sqrt(a * a + 0.1),
    "sin": ca.sin(a),
    "cos": ca.cos(a),
    "tan": ca.tan(a),
    "asin": ca.asin(between),
    "acos": ca.acos(between),
    "atan": ca.atan(a),
    "sinh": ca.sinh(between),
    "cosh": ca.cosh(between),
    "tanh": between,
    "exp": ca.exp(between),
    "log": ca.log(a * a + 0.1),
    "abs": ca.fabs(a),
    "sign": ca.sign(a) + ca.sign(0.0 * ca.floor(between)),
    "floor": ca.floor(a),
    "ceil": ca.ceil(a),
    "not": ca.logic_not(a > b),
    "pow": (a * a + 0.1) ** b,
    "atan2": ca.atan2(a, b),
    "hypot": ca.hypot(a, b),
    "copysign": ca.copysign(a, b),
    "min": ca.fmin(a, b),
    "max": ca.fmax(a, b),
    "lt": a < b,
    "le": a <= b,
    "eq": ca.eq(ca.floor(a), ca.floor(b)),
    "ne": ca.ne(ca.floor(a), ca.floor(b)),
    "and": ca.logic_and(ca.floor(a), ca.floor(b)),
    "or": ca.logic_or(ca.floor(a), ca.floor(b)),
    "if_else_zero": ca.if_else(a > b, between, 0.0),
}
N_LANES = 37  # more than one block of lanes, and not a whole number of them
# Each operation is within 2 units in the last place of the next (sin, atan and pow of two libraries are); a quotient
# or a power near its pole magnifies that by what is lost in the difference before it, here at most a hundredfold.
ROUNDING = 1e-13


def states(n: int) -> FloatArray:
    return np.random.default_rng(7).uniform(-3.0, 3.0, (n, 3))


@pytest.fixture(scope="module")
def gcc() -> Compiler:
    found = compiler()
    if found is None:
        pytest.skip("no C compiler here")
    return found


@pytest.fixture(scope="module")
def everything() -> tuple[ca.Function, TapeProgram]:
    function = ca.Function("everything", [x, u, p], [ca.vertcat(*EVERYTHING.values())])
    return function, program_of(function)


@pytest.fixture(scope="module")
def oscillator() -> tuple[ca.Function, TapeProgram]:
    """A damped swing with parts that depend on parameters, on the input, on both, on all; a state that stays."""
    rate = ca.vertcat(b, -(p[0] ** 2) * ca.sin(a) - p[1] * b + ca.tanh(u[0]) * p[0] + u[1] * a, 0.0)
    function = ca.Function("oscillator", [x, u, p], [x + 0.01 * rate])
    return function, program_of(function)


def of_each(function: ca.Function, at: FloatArray, inputs: FloatArray, parameters: FloatArray) -> FloatArray:
    return np.array(function(at.T, inputs.T, parameters.T)).T


def test_every_back_end_knows_every_operation(everything: tuple[ca.Function, TapeProgram], gcc: Compiler) -> None:
    """NumPy, and compiled code for one vehicle and many: a number per vehicle, or eight side by side."""
    function, program = everything
    assert {node.name for node in program.parts[0].body.nodes if isinstance(node, Operation)} == set(OPERATIONS)
    at, none = states(N_LANES), np.zeros((N_LANES, 2))
    expected, one = of_each(function, at, none, none), NativeOne(program, np.empty(0), gcc)
    for got in (
        NumpyMany(program, np.empty(0), N_LANES)(at, none),
        NativeMany(program, np.empty(0), gcc)(at, none),
        [one(state, none[0]) for state in at],
    ):
        np.testing.assert_allclose(got, expected, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize("shift", [0.0, 1e3, -1e6])
def test_own_sine_cosine_tangent_and_arc_tangent_are_exact_to_rounding(shift: float, gcc: Compiler) -> None:
    """Against the C library's, also where a tangent is huge and after a million radians of turning."""
    functions = ca.vertcat(ca.sin(a), ca.cos(a), ca.atan(b), ca.tan(x[2]))
    native = NativeMany(program_of(ca.Function("f", [x, u, p], [functions])), np.empty(0), gcc)
    angle = shift + np.concatenate([np.linspace(-7.0, 7.0, 20001), np.arange(-8, 9) * 0.25 * np.pi])
    argument = np.concatenate([np.linspace(-9.0, 9.0, len(angle) - 6), [0.0, 1e-9, -1e9, 1e300, 0.66, 1.0 + 2.0**0.5]])
    small = np.linspace(-1.4, 1.4, len(angle))
    got = native(np.column_stack([angle, argument, small]), np.zeros((len(angle), 2))).T
    np.testing.assert_allclose(got[0], np.sin(angle), rtol=0.0, atol=3e-16)  # 1.5 units of the last place below 1
    np.testing.assert_allclose(got[1], np.cos(angle), rtol=0.0, atol=3e-16)
    np.testing.assert_allclose(got[2], np.arctan(argument), rtol=5e-16, atol=0.0)  # 2 units
    np.testing.assert_allclose(got[3], np.tan(small), rtol=1e-15, atol=0.0)  # two roundings of the former, and one


@pytest.mark.parametrize("ticks", [1, 2, 7])
def test_all_back_ends_take_the_same_steps(
    oscillator: tuple[ca.Function, TapeProgram], gcc: Compiler, ticks: int
) -> None:
    """Ticks follow each other under a held input, with one set of numbers for all or one for each."""
    function, program = oscillator
    rng = np.random.default_rng(3)
    at, inputs, own = states(N_LANES), rng.normal(size=(N_LANES, 2)), rng.uniform(0.5, 2.0, (N_LANES, 2))
    shared = np.broadcast_to(own[0], own.shape)
    for parameters, given in ((shared, own[0]), (own, own)):
        expected = at
        for _ in range(ticks):
            expected = of_each(function, expected, inputs, parameters)
        worked_with = evaluated(program.parts[0].numbers, [np.empty(0), np.empty(0), given])
        for many in (NumpyMany(program, worked_with, N_LANES), NativeMany(program, worked_with, gcc)):
            np.testing.assert_allclose(many(at, inputs, ticks), expected, rtol=ROUNDING, atol=ROUNDING)
    folded = CasadiOne(ca.Function("folded", [x, u], [function(x, u, own[0])]))
    worked_with = evaluated(program.parts[0].numbers, [np.empty(0), np.empty(0), own[0]])
    for one in (folded, NativeOne(program, worked_with, gcc)):
        expected = at[0]
        for _ in range(ticks):
            expected = np.array(function(expected, inputs[0], own[0])).ravel()
        np.testing.assert_allclose(one(at[0], inputs[0], ticks), expected, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize("n", [1, 8, 511, 513, 1030])
def test_any_number_of_vehicles_fits(oscillator: tuple[ca.Function, TapeProgram], gcc: Compiler, n: int) -> None:
    """The last block is filled up with copies of the last vehicle, whose results nobody sees."""
    function, program = oscillator
    at, inputs = states(n), np.zeros((n, 2))
    own = evaluated(program.parts[0].numbers, [np.empty(0), np.empty(0), np.array([1.5, 0.3])])
    expected = of_each(function, at, inputs, np.broadcast_to([1.5, 0.3], (n, 2)))
    for many in (NumpyMany(program, own, n), NativeMany(program, own, gcc)):
        np.testing.assert_allclose(many(at, inputs), expected, rtol=ROUNDING, atol=ROUNDING)


def test_arguments_stay_as_they_are(oscillator: tuple[ca.Function, TapeProgram], gcc: Compiler) -> None:
    _, program = oscillator
    at, inputs = states(9), np.ones((9, 2))
    own = evaluated(program.parts[0].numbers, [np.empty(0), np.empty(0), np.array([1.5, 0.3])])
    for many in (NumpyMany(program, own, 9), NativeMany(program, own, gcc)):
        before = at.copy()
        first = many(at, inputs, 3)
        kept = first.copy()
        many(first, inputs, 3)
        np.testing.assert_array_equal(at, before)
        np.testing.assert_array_equal(first, kept)


def test_what_no_back_end_knows_is_refused() -> None:
    with pytest.raises(ValueError, match="operation"):
        program_of(ca.Function("f", [x, u, p], [ca.erf(a)]))
    with pytest.raises(ValueError, match="structural zeros"):
        program_of(ca.Function("f", [x, u, p], [ca.vertcat(a, ca.SX(1, 1))]))


def test_no_tick_divides_by_a_vehicles_number() -> None:
    """A divisor that is known before is inverted once; only a divisor that changes with the state is divided by."""
    function = ca.Function("f", [x, u, p], [ca.vertcat(a / p[0], b / p[0], a / u[1], p[0] / a, p[0] / p[1])])
    program = program_of(function)
    names = [node.name for node in program.parts[0].body.nodes if isinstance(node, Operation)]
    assert sorted(names) == ["div", "mul", "mul", "mul"]
    state, given, numbers = np.array([1.3, -0.7, 0.2]), np.array([0.4, 3.0]), np.array([1.7, -2.9])
    of_vehicle = evaluated(program.parts[0].numbers, [np.empty(0), np.empty(0), numbers])
    found = NumpyMany(program, of_vehicle, 1)(state[None], given[None])
    np.testing.assert_allclose(found[0], np.array(function(state, given, numbers)).ravel(), rtol=1e-15)
