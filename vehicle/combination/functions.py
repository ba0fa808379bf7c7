"""The chain's equations as CasADi functions of vectors, also with the vehicle's numbers as symbols.

Brakes are controlled in the middle of a step, by a function of their own: a command of the ABS switches.

A third argument takes the vehicle's numbers, in the order of ``symbolic.numbers``: such a function is built once for
all vehicles of one topology.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, wraps
from typing import Any, Final, Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from pydantic import BaseModel

from vehicle.clock import TICK
from vehicle.combination import layout
from vehicle.combination.actuators import brakes_later
from vehicle.combination.chain import (
    SmoothGround,
    body_poses,
    derivative,
    kinematics,
    relaxation,
    smooth_ground_sizes,
    wheel_travel,
    wheel_truth,
)
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.multibody import Vector, along
from vehicle.combination.sprung import settled
from vehicle.engine.function_cache import Call, Composite, derived_once
from vehicle.engine.integrator import after, damped_rate, half_weight, halfway
from vehicle.frames import FloatArray

_WORDS = frozenset(["name", "summary"])  # fields that no equation depends on
_IDLE = frozenset(["payload"])  # tables that no equation depends on


class SymbolicTwin(NamedTuple):
    """A vehicle with a symbol for each of its numbers, and the numbers."""

    vehicle: Vehicle  # its numbers are ``casadi.SX``
    symbols: ca.SX  # (n,)
    values: FloatArray  # (n,)


def symbolic_twin(vehicle: Vehicle) -> SymbolicTwin:
    """The vehicle with a symbol for every physical number, named by its path in the file."""
    symbols: list[ca.SX] = []

    def symbol(path: str, _: float) -> ca.SX:
        symbols.append(ca.SX.sym(path))
        return symbols[-1]

    twin = with_numbers(vehicle, symbol)
    return SymbolicTwin(twin, ca.vertcat(ca.SX(0, 1), *symbols), numbers(vehicle))


def numbers(vehicle: Vehicle) -> FloatArray:
    """Every physical number of a vehicle, in the order of its symbols."""
    values: list[float] = []
    with_numbers(vehicle, lambda _, value: values.append(value))
    return np.array(values)


@lru_cache(maxsize=64)
def topology(vehicle: Vehicle) -> Vehicle:
    """The vehicle without numbers and names: equal for vehicles with the same equations."""
    bare: Vehicle = with_numbers(vehicle, lambda *_: 0.0, words=False)
    return bare


def with_numbers(thing: Any, number: Callable[[str, float], Any], path: str = "", *, words: bool = True) -> Any:
    """A copy with every number replaced by ``number(path, value)``; not validated, as numbers may be symbols."""

    def copied(part: Any, key: object) -> Any:
        return with_numbers(part, number, f"{path}.{key}", words=words)

    if isinstance(thing, BaseModel):
        fields: dict[str, Any] = {
            name: "" if name in _WORDS and not words else None if name in _IDLE else copied(value, name)
            for name, value in thing
        }
        return type(thing).model_construct(**fields)
    if isinstance(thing, tuple | list):
        return type(thing)(copied(part, k) for k, part in enumerate(thing))
    if isinstance(thing, int | float) and not isinstance(thing, bool):
        return number(path.removeprefix("."), thing)
    return thing


def brake_states(vehicle: Vehicle) -> range:
    """Numbers of the states of brakes, which advance by a rule of their own; they are the last ones."""
    at = layout.State(*layout.slices(layout.state_sizes(vehicle)))
    return range(at.brake_pressure.start, at.brake_valve.stop)


def step_in_calls(
    vehicle: Vehicle, x: ca.SX, v: ca.SX, u: layout.Input[ca.SX], numbers: ca.SX, *, timed: bool = False
) -> Composite:
    """Function (state, plant's input, numbers) -> state one tick later.

    ``x``, ``v`` and ``numbers`` are its symbols, ``u`` is the chain's input in terms of ``v``. The last entry of the
    input of a ``timed`` step is its length [s].
    """
    chain, s, at = (
        layout.Chain.of(vehicle),
        _named(vehicle, x),
        layout.State(*layout.slices(layout.state_sizes(vehicle))),
    )
    n, step = brake_states(vehicle).start, v[-1] if timed else TICK
    rates = _Rates(chain, s, u, n)
    of_rates = ca.Function("rates", [x, v, numbers], [rates.entries])
    now, middle, then = (ca.SX.sym("v", size) for size in (rates.entries.numel(), x.numel() + n, n))
    halfway_there = _named(vehicle, middle[: x.numel()])._replace(
        brake_pressure=s.brake_pressure, brake_valve=s.brake_valve
    )
    brakes = brakes_later(chain, halfway_there, ca.vertsplit(rates.travel(now)), ca.vertsplit(then[at.omega]), step)
    later = ca.vertcat(ca.SX(0, 1), *brakes.pressure, *brakes.valve)
    calls = (
        Call(of_rates),
        Call(_halfway(rates, of_rates, timed=timed), results=(1,)),
        Call(of_rates, state=2, needed=n),
        Call(ca.Function("brakes", [x, v, numbers, now, middle, then], [ca.cse(later)]), results=(1, 2, 3)),
        Call(_after(rates, of_rates), results=(1, 2, 3, 4)),
    )
    return Composite("step", calls)


# CasADi's machine runs every operation of these two functions on a whole vector.


def _halfway(rates: "_Rates", of_rates: Any, *, timed: bool) -> Any:
    """Function (state, input, numbers, rates) -> state halfway, and the weights of half a step."""
    x, v, numbers = _arguments(of_rates)
    now, step = ca.MX.sym("now", of_rates.numel_out(0)), v[-1] if timed else TICK
    half = _chosen(half_weight(rates.relaxing(now), step), rates.places, half_weight(0.0, step))
    continuous = halfway(x[: rates.n], rates.rate(now), half)
    filling = rates.filling(now)
    valves = rates.n + filling.numel()
    pressures = halfway(x[rates.n : valves], filling, half_weight(0.0, step))
    return ca.Function("halfway", [x, v, numbers, now], [ca.vertcat(continuous, pressures, x[valves:], half)])


def _after(rates: "_Rates", of_rates: Any) -> Any:
    """Function (state, input, numbers, rates, halfway, rates halfway, brakes later) -> state later."""
    x, v, numbers = _arguments(of_rates)
    now, then = ca.MX.sym("now", of_rates.numel_out(0)), ca.MX.sym("then", rates.n)
    between, brakes = ca.MX.sym("halfway", x.numel() + rates.n), ca.MX.sym("brakes", x.numel() - rates.n)
    damped = _chosen(damped_rate(rates.relaxing(now)), rates.places, 0.0)
    continuous = after(x[: rates.n], rates.rate(now), then, damped, between[x.numel() :])
    return ca.Function("after", [x, v, numbers, now, between, then, brakes], [ca.vertcat(continuous, brakes)])


def _arguments(function: Any) -> list[Any]:
    return [ca.MX.sym("v", function.numel_in(k)) for k in range(3)]


class _Rates:
    """The result of the rates' function: rates of the n continuous states, then what else is needed, each once."""

    def __init__(self, chain: layout.Chain, s: layout.State[ca.SX], u: layout.Input[ca.SX], n: int) -> None:
        self.n = n
        rate, relaxing = ca.vertcat(*derivative(chain, s, u)), ca.vertcat(*relaxation(chain, s, u))[:n]
        travel = wheel_travel(chain, s, u) if n < rate.numel() else ca.SX(0, 1)
        valves = n + s.brake_pressure.numel()
        whole = ca.vertsplit(ca.cse(ca.densify(ca.vertcat(rate[:n], relaxing, rate[n:valves], travel))))
        distinct: dict[Any, int] = {}
        numbers = [
            None if entry.is_zero() else distinct.setdefault(entry.element_hash(), len(distinct)) for entry in whole[n:]
        ]
        self.places, self._pressures, self._travel = numbers[:n], numbers[n:valves], numbers[valves:]
        self._n_relaxing = 1 + max((place for place in self.places if place is not None), default=-1)
        first = [n + numbers.index(k) for k in range(len(distinct))]
        self.entries = ca.vertcat(*whole[:n], *(whole[k] for k in first))

    def rate(self, entries: Any) -> Any:
        """Rate of every continuous state."""
        return entries[: self.n]

    def relaxing(self, entries: Any) -> Any:
        """The distinct relaxation rates that are not zero; ``places`` tells whose they are."""
        return entries[self.n : self.n + self._n_relaxing]

    def filling(self, entries: Any) -> Any:
        """Rate of every brake's pressure."""
        return _chosen(entries[self.n :], self._pressures, 0.0)

    def travel(self, entries: Any) -> Any:
        """``wheel_travel``."""
        return _chosen(entries[self.n :], self._travel, 0.0)


def _chosen(entries: Any, places: list[int | None], otherwise: float) -> Any:
    """Entries by place, and a number where there is none."""
    n = entries.numel()
    return ca.vertcat(entries, otherwise)[[n if place is None else place for place in places]]


V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class _Start(NamedTuple, Generic[V]):
    """Chosen part of the state; the field order is the order in the vector."""

    x: V  # of To in W [m]
    y: V
    psi: V  # of the straight combination [rad]
    speed: V  # [m/s]


_START_SIZES: Final = _Start(1, 1, 1, 1)


def _rolling_freely(vehicle: Vehicle, start: _Start[ca.SX], ground: layout.GroundInputs[ca.SX]) -> layout.State[ca.SX]:
    """State of the straight combination rolling freely, its bodies settled on their springs."""
    sizes = layout.state_sizes(vehicle)
    course = Vector(ca.cos(start.psi), ca.sin(start.psi))
    gravity_x, gravity_y = layout.gravity_along(ground.slope_x, ground.slope_y)
    pulls = [along(course, Vector(gravity_x[i], gravity_y[i])) for i in range(len(vehicle.units))]
    bodies = settled(vehicle, [-pull.x for pull in pulls], [-pull.y for pull in pulls])
    resting = layout.State(*(ca.SX.zeros(size) for size in sizes))
    return resting._replace(
        x=start.x,
        y=start.y,
        psi=ca.repmat(start.psi, sizes.psi, 1),
        v_x=start.speed,
        heave=ca.vertcat(*(attitude.heave for attitude, _ in bodies)),
        pitch=ca.vertcat(*(attitude.pitch for attitude, _ in bodies)),
        roll=ca.vertcat(*(attitude.roll for attitude, _ in bodies)),
        heave_spring=ca.vertcat(*(spring.heave for _, spring in bodies)),
        pitch_spring=ca.vertcat(*(spring.pitch for _, spring in bodies)),
        roll_spring=ca.vertcat(*(spring.roll for _, spring in bodies)),
        side_force=_side_forces(vehicle, pulls),
        omega=ca.vertcat(*(start.speed / wheel.axle.wheel_radius for wheel in layout.wheels(vehicle))),
        brake_windup=ca.repmat(ca.sign(start.speed), sizes.brake_windup, 1),
    )


def _side_forces(vehicle: Vehicle, pulls: Sequence[Vector]) -> ca.SX:
    """Side force [N] with which each axle holds its share of the vehicle on a slope; none without suspensions."""
    if not vehicle.has_springs:
        return ca.SX(0, 1)
    loads = static_axle_loads(vehicle)
    return ca.vertcat(
        *(-load / GRAVITY * pull.y for of_unit, pull in zip(loads, pulls, strict=True) for load in of_unit)
    )


def _once_per_topology(build: Callable[[SymbolicTwin], Any]) -> Callable[[Vehicle], Any]:
    """Function of a vehicle that builds once per topology."""

    @lru_cache(maxsize=16)
    def built(bare: Vehicle) -> Any:
        return derived_once(f"{__name__}.{build.__name__}", (bare,), lambda: build(symbolic_twin(bare)))

    @wraps(build)
    def of_vehicle(vehicle: Vehicle) -> Any:
        return built(topology(vehicle))

    return of_vehicle


@_once_per_topology
def step_function(twin: SymbolicTwin) -> Composite:
    """Function (state, command and ground inputs, numbers) -> state one tick later."""
    x, v = _state(twin.vehicle), _plant_input(twin.vehicle)
    return step_in_calls(twin.vehicle, x, v, _chain_input(twin.vehicle, v), twin.symbols)


@_once_per_topology
def timed_step_function(twin: SymbolicTwin) -> Composite:
    """Function (state, command and ground inputs and length of the step [s], numbers) -> state after the step."""
    x, v = _state(twin.vehicle), ca.vertcat(_plant_input(twin.vehicle), ca.SX.sym("step"))
    return step_in_calls(twin.vehicle, x, v, _chain_input(twin.vehicle, v[:-1]), twin.symbols, timed=True)


@_once_per_topology
def wheel_function(twin: SymbolicTwin) -> Any:
    """Function (state, command and ground inputs, numbers) -> ``WheelTruth``."""
    x, v = _state(twin.vehicle), _plant_input(twin.vehicle)
    truth = wheel_truth(twin.vehicle, _named(twin.vehicle, x), _chain_input(twin.vehicle, v))
    return ca.Function("wheels", [x, v, twin.symbols], [ca.cse(ca.vertcat(*truth))])


@_once_per_topology
def kinematics_function(twin: SymbolicTwin) -> Any:
    """Function (state, nothing, numbers) -> ``Kinematics``."""
    x = _state(twin.vehicle)
    motion = kinematics(twin.vehicle, _named(twin.vehicle, x))
    return ca.Function("kinematics", [x, ca.SX(0, 1), twin.symbols], [ca.cse(ca.vertcat(*motion))])


@_once_per_topology
def body_function(twin: SymbolicTwin) -> Any:
    """Function (state, ``SmoothGround``, numbers) -> X_WB of every body, row by row."""
    x, g = _state(twin.vehicle), _vector(smooth_ground_sizes(twin.vehicle))
    poses = body_poses(
        twin.vehicle, _named(twin.vehicle, x), SmoothGround(*layout.parts(g, smooth_ground_sizes(twin.vehicle)))
    )
    return ca.Function("bodies", [x, g, twin.symbols], [ca.cse(poses)])


@_once_per_topology
def start_function(twin: SymbolicTwin) -> Any:
    """Function (nothing, start and ground inputs, numbers) -> state."""
    v = _vector((*_START_SIZES, *layout.ground_input_sizes(twin.vehicle)))
    start, ground = _two(v, _START_SIZES, layout.ground_input_sizes(twin.vehicle))
    state = _rolling_freely(twin.vehicle, _Start(*start), layout.GroundInputs(*ground))
    return ca.Function("start", [ca.SX(0, 1), v, twin.symbols], [ca.densify(ca.vertcat(*state))])


@lru_cache(maxsize=16)
def compiled(part: Callable[..., Iterable[ca.SX]], vehicle: Vehicle) -> Any:
    """Function (state, chain's input) -> ``part`` of the chain, which is ``chain.derivative`` or ``chain.output``."""
    x, u = _state(vehicle), _vector(layout.input_sizes(vehicle))
    given = layout.Input(*layout.parts(u, layout.input_sizes(vehicle)))
    values = part(layout.Chain.of(vehicle), _named(vehicle, x), given)
    return ca.Function(part.__name__, [x, u], [ca.cse(ca.vertcat(*values))])


def _chain_input(vehicle: Vehicle, v: ca.SX) -> layout.Input[ca.SX]:
    command, ground = _two(v, layout.command_sizes(vehicle), layout.ground_input_sizes(vehicle))
    return layout.chain_input(vehicle, layout.CommandInputs(*command), layout.GroundInputs(*ground))


def _two(vector: ca.SX, first: Sequence[int], second: Sequence[int]) -> tuple[list[ca.SX], list[ca.SX]]:
    """Parts of two vectors that are concatenated."""
    both = layout.parts(vector, (*first, *second))
    return both[: len(first)], both[len(first) :]


def _named(vehicle: Vehicle, x: ca.SX) -> layout.State[ca.SX]:
    return layout.State(*layout.parts(x, layout.state_sizes(vehicle)))


def _state(vehicle: Vehicle) -> ca.SX:
    return _vector(layout.state_sizes(vehicle))


def _plant_input(vehicle: Vehicle) -> ca.SX:
    return _vector((*layout.command_sizes(vehicle), *layout.ground_input_sizes(vehicle)))


def _vector(sizes: Iterable[int]) -> ca.SX:
    return ca.SX.sym("v", sum(sizes))
