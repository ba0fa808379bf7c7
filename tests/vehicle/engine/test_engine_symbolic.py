"""One set of equations serves all vehicles built alike."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from vehicle.combination.chain import derivative
from vehicle.combination.description import Vehicle, load_vehicle, vehicle_names
from vehicle.combination.functions import compiled_derivative, numbers, step_function, symbolic_twin, topology
from vehicle.combination.layout import Chain, Input, State, input_sizes, parts, state_sizes


def test_symbols_are_named_after_their_places_in_the_file(tractor_semitrailer: Vehicle) -> None:
    """A derivative by the symbol is a sensitivity to that number; words and switches are no numbers."""
    twin = symbolic_twin(tractor_semitrailer)
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
    twin = symbolic_twin(vehicle)
    sizes, of_input = state_sizes(vehicle), input_sizes(vehicle)
    x, u = ca.SX.sym("x", sum(sizes)), ca.SX.sym("u", sum(of_input))
    rates = derivative(Chain.of(twin.vehicle), State(*parts(x, sizes)), Input(*parts(u, of_input)))
    rng = np.random.default_rng(4)
    state = rng.uniform(0.01, 0.1, sum(sizes))
    given = np.concatenate(
        Input(*(rng.uniform(0.1, 0.5, size) for size in of_input))._replace(friction=np.full(of_input.friction, 0.7))
    )
    got = ca.Function("f", [x, u, twin.symbols], [ca.vertcat(*rates)])(state, given, twin.values)
    # The same operations but for constants folded in another order: some hundred roundings, and cancellation below 10.
    np.testing.assert_allclose(got, compiled_derivative(vehicle)(state, given), rtol=1e-10, atol=1e-12)


def test_equal_structure_is_equal_topology(tractor_semitrailer: Vehicle, longer_semitrailer: Vehicle) -> None:
    """Other numbers and another name share the equations; another axle, group or tyre law does not."""
    tractor, trailer = tractor_semitrailer.units
    heavier = tractor_semitrailer.model_copy(
        update={"name": "heavier", "units": (tractor, trailer.model_copy(update={"mass": 40e3}))}
    )
    shorter = tractor_semitrailer.model_copy(
        update={"units": (tractor, trailer.model_copy(update={"axles": trailer.axles[:2]}))}
    )
    assert topology(heavier) == topology(tractor_semitrailer)
    assert hash(topology(heavier)) == hash(topology(tractor_semitrailer))
    assert step_function(heavier) is step_function(tractor_semitrailer)
    assert not np.array_equal(numbers(heavier), numbers(tractor_semitrailer))
    grouped, single = (load_vehicle(f"uk_longer_semitrailer{which}") for which in ("_grouped", ""))
    for other in (shorter, longer_semitrailer, grouped):
        assert topology(other) != topology(tractor_semitrailer)
    assert topology(grouped) != topology(single)
