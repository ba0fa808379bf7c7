"""The chain's equations as CasADi functions of vectors.

A third argument takes the vehicle's numbers, in the order of ``symbolic.numbers``: such a function is built once for
all vehicles of one topology.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, wraps
from typing import Any, Final, Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.attitude import SmoothGround, body_poses, smooth_ground_sizes
from vehicle.combination.chain import derivative, output
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Input, State, input_sizes, parts, state_sizes, wheels
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.multibody import Vector, along
from vehicle.combination.plant_inputs import (
    CommandInputs,
    GroundInputs,
    chain_input,
    command_sizes,
    gravity_along,
    ground_input_sizes,
)
from vehicle.combination.sprung import settled
from vehicle.combination.step_calls import step_in_calls
from vehicle.combination.symbolic import SymbolicTwin, symbolic_twin, topology
from vehicle.combination.truth_vectors import kinematics, wheel_truth
from vehicle.engine.composite import Composite
from vehicle.engine.function_cache import derived_once

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class _Start(NamedTuple, Generic[V]):
    """Chosen part of the state; the field order is the order in the vector."""

    x: V  # of To in W [m]
    y: V
    psi: V  # of the straight combination [rad]
    speed: V  # [m/s]


_START_SIZES: Final = _Start(1, 1, 1, 1)


def _rolling_freely(vehicle: Vehicle, start: _Start[ca.SX], ground: GroundInputs[ca.SX]) -> State[ca.SX]:
    """State of the straight combination rolling freely, its bodies settled on their springs."""
    sizes = state_sizes(vehicle)
    course = Vector(ca.cos(start.psi), ca.sin(start.psi))
    gravity_x, gravity_y = gravity_along(ground.slope_x, ground.slope_y)
    pulls = [along(course, Vector(gravity_x[i], gravity_y[i])) for i in range(len(vehicle.units))]
    bodies = settled(vehicle, [-pull.x for pull in pulls], [-pull.y for pull in pulls])
    resting = State(*(ca.SX.zeros(size) for size in sizes))
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
        omega=ca.vertcat(*(start.speed / wheel.axle.wheel_radius for wheel in wheels(vehicle))),
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
        twin.vehicle, _named(twin.vehicle, x), SmoothGround(*parts(g, smooth_ground_sizes(twin.vehicle)))
    )
    return ca.Function("bodies", [x, g, twin.symbols], [ca.cse(poses)])


@_once_per_topology
def start_function(twin: SymbolicTwin) -> Any:
    """Function (nothing, start and ground inputs, numbers) -> state."""
    v = _vector((*_START_SIZES, *ground_input_sizes(twin.vehicle)))
    start, ground = _two(v, _START_SIZES, ground_input_sizes(twin.vehicle))
    state = _rolling_freely(twin.vehicle, _Start(*start), GroundInputs(*ground))
    return ca.Function("start", [ca.SX(0, 1), v, twin.symbols], [ca.densify(ca.vertcat(*state))])


@lru_cache(maxsize=8)
def compiled_derivative(vehicle: Vehicle) -> Any:
    """Function (state, chain's input) -> time derivative of the state."""
    x, u = _state(vehicle), _vector(input_sizes(vehicle))
    return ca.Function("derivative", [x, u], [ca.cse(_rate(vehicle, x, Input(*parts(u, input_sizes(vehicle)))))])


@lru_cache(maxsize=8)
def compiled_output(vehicle: Vehicle) -> Any:
    """Function (state, chain's input) -> output."""
    x, u = _state(vehicle), _vector(input_sizes(vehicle))
    outputs = output(vehicle, _named(vehicle, x), Input(*parts(u, input_sizes(vehicle))))
    return ca.Function("output", [x, u], [ca.vertcat(*outputs)])


def _rate(vehicle: Vehicle, x: ca.SX, u: Input[ca.SX]) -> ca.SX:
    return ca.vertcat(*derivative(vehicle, _named(vehicle, x), u))


def _chain_input(vehicle: Vehicle, v: ca.SX) -> Input[ca.SX]:
    command, ground = _two(v, command_sizes(vehicle), ground_input_sizes(vehicle))
    return chain_input(vehicle, CommandInputs(*command), GroundInputs(*ground))


def _two(vector: ca.SX, first: Sequence[int], second: Sequence[int]) -> tuple[list[ca.SX], list[ca.SX]]:
    """Parts of two vectors that are concatenated."""
    both = parts(vector, (*first, *second))
    return both[: len(first)], both[len(first) :]


def _named(vehicle: Vehicle, x: ca.SX) -> State[ca.SX]:
    return State(*parts(x, state_sizes(vehicle)))


def _state(vehicle: Vehicle) -> ca.SX:
    return _vector(state_sizes(vehicle))


def _plant_input(vehicle: Vehicle) -> ca.SX:
    return _vector((*command_sizes(vehicle), *ground_input_sizes(vehicle)))


def _vector(sizes: Iterable[int]) -> ca.SX:
    return ca.SX.sym("v", sum(sizes))
