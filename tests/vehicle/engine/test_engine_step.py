"""One tick of a vehicle four ways: CasADi's machine, compiled C, and many at a time in numpy and in C."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from offtrack.studies.validation import equations
from vehicle.clock import TICK
from vehicle.combination import functions, layout
from vehicle.combination.actuators import brakes_later
from vehicle.combination.chain import derivative, relaxation, wheel_travel
from vehicle.combination.description import Vehicle, load_vehicle, vehicle_names
from vehicle.engine.compiler import compiler
from vehicle.engine.integrator import after, damped_rate, half_weight, halfway
from vehicle.engine.kernels import Engine, kernel_for_many, kernel_for_one
from vehicle.foundation.user_cache import warn_once
from vehicle.frames import FloatArray

with_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")
N = 50


def random_states(vehicle: Vehicle) -> FloatArray:
    """Driving, standing, sliding and spinning, far from any trim, (N, n_state)."""
    return equations.random_states(vehicle, np.random.default_rng(8), N).T


def random_inputs(vehicle: Vehicle) -> FloatArray:
    """CommandInputs and ground, (N, n_demands + n_footing)."""
    rng = np.random.default_rng(9)
    demands, under = layout.command_sizes(vehicle), layout.ground_input_sizes(vehicle)
    return np.hstack(
        [
            rng.uniform(-0.6, 0.6, (N, demands.steer)),
            rng.uniform(-5.0, 2.0, (N, demands.acceleration)),
            rng.uniform(-0.4, 0.4, (N, demands.trailer_steer)),
            np.where(np.arange(N) % 2, 1.0, -1.0)[:, None],
            rng.uniform(0.1, 1.0, (N, under.friction)),
            rng.uniform(-0.1, 0.1, (N, under.slope_x + under.slope_y)),
            rng.uniform(-0.05, 0.05, (N, under.road)),
        ]
    )


def one_by_one(function: Any, vehicle: Vehicle, engine: Engine, ticks: int = 1) -> FloatArray:
    kernel = kernel_for_one(function, functions.numbers(vehicle), engine)
    return np.array([kernel(x, u, ticks) for x, u in zip(random_states(vehicle), random_inputs(vehicle), strict=True)])


def all_at_once(function: Any, vehicle: Vehicle, engine: Engine, ticks: int = 1) -> FloatArray:
    kernel = kernel_for_many(function, functions.numbers(vehicle), N, engine)
    return kernel(random_states(vehicle), random_inputs(vehicle), ticks)


# Some 2000 roundings of 1e-16; forces of 1e5 N cancel to what accelerates a wheel of 12 kg m2 within 1 ms, which costs
# four digits, and the stiff modes pass on less than they get.
ROUNDING = 1e-11


@pytest.mark.parametrize("ticks", [1, 2, 5])
def test_the_step_in_calls_is_that_of_the_integrator(chain: Vehicle, ticks: int) -> None:
    """The integrator's step written in one piece, and the brakes advanced by the rates in its middle."""
    x, v = ca.SX.sym("x", sum(layout.state_sizes(chain))), ca.SX.sym("v", random_inputs(chain).shape[1])
    sizes = layout.command_sizes(chain), layout.ground_input_sizes(chain)
    command, ground = (
        layout.parts(part, of) for part, of in zip(layout.parts(v, [sum(s) for s in sizes]), sizes, strict=True)
    )
    u = layout.chain_input(chain, layout.CommandInputs(*command), layout.GroundInputs(*ground))
    lists, s, at = (
        layout.Chain.of(chain),
        layout.State(*layout.parts(x, layout.state_sizes(chain))),
        layout.State(*layout.slices(layout.state_sizes(chain))),
    )
    derived, relaxing = functions.compiled(derivative, chain), ca.vertcat(*relaxation(lists, s, u))

    def rate(state: ca.SX) -> Any:
        return derived(state, ca.vertcat(*u))

    half = half_weight(relaxing, TICK)
    middle = ca.vertcat(halfway(x, rate(x), half)[: at.brake_valve.start], s.brake_valve)
    whole = after(x, rate(x), rate(middle), damped_rate(relaxing), half)
    there = layout.State(*layout.parts(middle, layout.state_sizes(chain)))._replace(brake_pressure=s.brake_pressure)
    travel, spin = ca.vertsplit(wheel_travel(lists, s, u)), ca.vertsplit(rate(middle)[at.omega])
    brakes = brakes_later(lists, there, travel, spin, TICK)
    n = functions.brake_states(chain).start
    one = ca.Function("one", [x, v], [ca.vertcat(whole[:n], *brakes.pressure, *brakes.valve)])
    found = one_by_one(functions.step_function(chain), chain, "interpreted", ticks)
    for state, given, got in zip(random_states(chain), random_inputs(chain), found, strict=True):
        for _ in range(ticks):
            state = np.array(one(state, given)).ravel()
        np.testing.assert_allclose(got, state, rtol=ROUNDING, atol=ROUNDING)


Function = Callable[[Vehicle], Any]


def check_all_ways(of: Function, vehicle: Vehicle, engine: Engine, ticks: int) -> None:
    """One vehicle at a time, many with common numbers, and many with numbers of their own, here the same."""
    function, own = of(vehicle), np.tile(functions.numbers(vehicle), (N, 1))
    expected = one_by_one(function, vehicle, "interpreted", ticks)
    assert np.isfinite(expected).all()
    rows = kernel_for_many(function, own, N, engine)(random_states(vehicle), random_inputs(vehicle), ticks)
    for got in (one_by_one(function, vehicle, engine, ticks), all_at_once(function, vehicle, engine, ticks), rows):
        np.testing.assert_allclose(got, expected, rtol=ROUNDING, atol=ROUNDING)


@pytest.mark.parametrize("ticks", [1, 5])
def test_many_in_numpy_are_each_as_interpreted(chain: Vehicle, ticks: int) -> None:
    check_all_ways(functions.step_function, chain, "interpreted", ticks)


@pytest.mark.slow
@with_compiler
@pytest.mark.parametrize("ticks", [1, 5])
@pytest.mark.parametrize("name", ["tractor_semitrailer", "longer_semitrailer"])
def test_compiled_steps_are_as_interpreted(name: str, ticks: int, request: pytest.FixtureRequest) -> None:
    check_all_ways(functions.step_function, request.getfixturevalue(name), "compiled", ticks)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["interpreted", pytest.param("compiled", marks=with_compiler)])
def test_wheels_look_alike_all_ways(longer_semitrailer: Vehicle, engine: Engine) -> None:
    """Loads, slip and friction used, with an arc tangent of our own in compiled code."""
    check_all_ways(functions.wheel_function, longer_semitrailer, engine, 1)


def test_without_a_compiler_it_runs_interpreted_and_says_so(
    tractor_semitrailer: Vehicle, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Nothing is missing but speed; who insists on compiled code is told why there is none."""
    monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    function, values = functions.step_function(tractor_semitrailer), functions.numbers(tractor_semitrailer)
    x, u = random_states(tractor_semitrailer), random_inputs(tractor_semitrailer)
    warn_once.cache_clear()
    after = kernel_for_one(function, values, "auto")(x[0], u[0])
    assert "vehicle models are interpreted" in caplog.text
    np.testing.assert_array_equal(after, kernel_for_one(function, values, "interpreted")(x[0], u[0]))
    with pytest.raises(ValueError, match="needs a C compiler"):
        kernel_for_one(function, values, "compiled")
    with pytest.raises(ValueError, match="engine = 'fast' must be one of auto, compiled, interpreted"):
        kernel_for_one(function, values, "fast")  # type: ignore[arg-type]  # what a settings file could say


@with_compiler
def test_a_compiler_that_fails_is_done_without(
    tractor_semitrailer: Vehicle, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    """It says what it can but compiles nothing, as with a library missing: a warning, and the step is interpreted."""
    real = compiler()
    assert real is not None
    broken = tmp_path / "cc"
    broken.write_text(f'#!/bin/sh\ncase "$*" in *-dM*) exec {real.path} "$@";; esac\necho out of order >&2\nexit 1\n')
    broken.chmod(0o755)
    monkeypatch.setenv("OFFTRACK_COMPILER", str(broken))
    monkeypatch.setenv("OFFTRACK_CACHE", str(tmp_path / "cache"))
    function, values = functions.step_function(tractor_semitrailer), functions.numbers(tractor_semitrailer)
    x, u = random_states(tractor_semitrailer), random_inputs(tractor_semitrailer)
    np.testing.assert_array_equal(
        kernel_for_one(function, values, "auto")(x[0], u[0]),
        kernel_for_one(function, values, "interpreted")(x[0], u[0]),
    )
    assert "out of order" in caplog.text
    with pytest.raises(ValueError, match="out of order"):
        kernel_for_many(function, values, N, "compiled")


# One set of equations serves all vehicles built alike


def test_symbols_are_named_after_their_places_in_the_file(tractor_semitrailer: Vehicle) -> None:
    """A derivative by the symbol is a sensitivity to that number; words and switches are no numbers."""
    twin = functions.symbolic_twin(tractor_semitrailer)
    named = dict(zip((symbol.name() for symbol in ca.vertsplit(twin.symbols)), twin.values, strict=True))
    assert named["units.1.mass"] == tractor_semitrailer.units[1].mass
    assert named["units.1.axles.2.tyre.damping"] == tractor_semitrailer.units[1].axles[2].tyre.damping
    assert not any(place.endswith(("steered", "name", "model")) for place in named)
    assert str(twin.vehicle.units[1].follow_x) == "units.1.follow_x"
    assert twin.vehicle.units[1].hitch_x is None
    assert twin.vehicle.name == tractor_semitrailer.name


@pytest.mark.slow
@pytest.mark.parametrize("name", vehicle_names())
def test_the_twin_with_its_numbers_is_the_vehicle(name: str) -> None:
    """Every shipped vehicle: rates of a random state from the symbols and from the numbers."""
    vehicle = load_vehicle(name)
    twin = functions.symbolic_twin(vehicle)
    sizes, of_input = layout.state_sizes(vehicle), layout.input_sizes(vehicle)
    x, u = ca.SX.sym("x", sum(sizes)), ca.SX.sym("u", sum(of_input))
    rates = derivative(
        layout.Chain.of(twin.vehicle), layout.State(*layout.parts(x, sizes)), layout.Input(*layout.parts(u, of_input))
    )
    rng = np.random.default_rng(4)
    state = rng.uniform(0.01, 0.1, sum(sizes))
    given = np.concatenate(
        layout.Input(*(rng.uniform(0.1, 0.5, size) for size in of_input))._replace(
            friction=np.full(of_input.friction, 0.7)
        )
    )
    got = ca.Function("f", [x, u, twin.symbols], [ca.vertcat(*rates)])(state, given, twin.values)
    # The same operations but for constants folded in another order: some hundred roundings, and cancellation below 10.
    np.testing.assert_allclose(got, functions.compiled(derivative, vehicle)(state, given), rtol=1e-10, atol=1e-12)


def test_equal_structure_is_equal_topology(tractor_semitrailer: Vehicle, longer_semitrailer: Vehicle) -> None:
    """Other numbers and another name share the equations; another axle, group or tyre law does not."""
    tractor, trailer = tractor_semitrailer.units
    heavier = tractor_semitrailer.model_copy(
        update={"name": "heavier", "units": (tractor, trailer.model_copy(update={"mass": 40e3}))}
    )
    shorter = tractor_semitrailer.model_copy(
        update={"units": (tractor, trailer.model_copy(update={"axles": trailer.axles[:2]}))}
    )
    assert functions.topology(heavier) == functions.topology(tractor_semitrailer)
    assert hash(functions.topology(heavier)) == hash(functions.topology(tractor_semitrailer))
    assert functions.step_function(heavier) is functions.step_function(tractor_semitrailer)
    assert not np.array_equal(functions.numbers(heavier), functions.numbers(tractor_semitrailer))
    grouped, single = (load_vehicle(f"uk_longer_semitrailer{which}") for which in ("_grouped", ""))
    for other in (shorter, longer_semitrailer, grouped):
        assert functions.topology(other) != functions.topology(tractor_semitrailer)
    assert functions.topology(grouped) != functions.topology(single)
