"""The chain's equations as CasADi functions of vectors.

A third argument takes the vehicle's numbers, in the order of ``symbolic.numbers``: such a function is built once for
all vehicles of one topology.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, wraps
from typing import Any

import casadi as ca

from vehicle.clock import TICK
from vehicle.combination.attitude import SmoothGround, body_poses, smooth_ground_sizes
from vehicle.combination.chain import derivative, output, relaxation
from vehicle.combination.description import Vehicle
from vehicle.combination.kinematics import kinematics
from vehicle.combination.layout import Input, State, input_sizes, parts, state_sizes
from vehicle.combination.plant_inputs import CommandInputs, GroundInputs, chain_input, command_sizes, ground_input_sizes
from vehicle.combination.start import START_SIZES, Start, rolling_freely
from vehicle.combination.symbolic import SymbolicTwin, symbolic_twin, topology
from vehicle.combination.wheel_truth import wheel_truth
from vehicle.integrator import semi_implicit_step


def _once_per_topology(build: Callable[[SymbolicTwin], Any]) -> Callable[[Vehicle], Any]:
    """Function of a vehicle that builds once per topology."""
    built = lru_cache(maxsize=16)(lambda bare: build(symbolic_twin(bare)))

    @wraps(build)
    def of_vehicle(vehicle: Vehicle) -> Any:
        return built(topology(vehicle))

    return of_vehicle


@_once_per_topology
def step_function(twin: SymbolicTwin) -> Any:
    """Function (state, command and ground inputs, numbers) -> state one tick later."""
    x, v = _state(twin.vehicle), _plant_input(twin.vehicle)
    u = _chain_input(twin.vehicle, v)
    stiff = ca.vertcat(*relaxation(twin.vehicle, _named(twin.vehicle, x), u))
    after = semi_implicit_step(lambda state: _rate(twin.vehicle, state, u), x, TICK, stiff)
    return ca.Function("step", [x, v, twin.symbols], [ca.cse(after)])


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
    v = _vector((*START_SIZES, *ground_input_sizes(twin.vehicle)))
    start, ground = _two(v, START_SIZES, ground_input_sizes(twin.vehicle))
    state = rolling_freely(twin.vehicle, Start(*start), GroundInputs(*ground))
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
