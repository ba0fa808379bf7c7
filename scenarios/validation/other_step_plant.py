"""The plant with another step size, finer or coarser than a tick, as a reference for the default step."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from vehicle.clock import TICK
from vehicle.combination.chain import derivative, relaxation
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Input, State, input_sizes, parts, state_sizes
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.integrator import semi_implicit_step
from vehicle.surface import Surface


class OtherStepPlant:
    """A plant on level ground of uniform friction with an integration step of ``step`` [s]."""

    def __init__(self, vehicle: Vehicle, friction: float, step: float) -> None:
        self._vehicle, self._friction, self._step = vehicle, friction, step
        self._plant = Plant(vehicle, Surface(friction=friction))

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State of the straight combination rolling freely at ``speed`` [m/s]."""
        return self._plant.initial_state(pose, speed)

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """Ground truth for this state."""
        return self._plant.observe(state, tick)

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command; no unit's axles may share an actuator."""
        u = self._input(command)
        return np.array(_steps(self._vehicle, self._step, round(ticks * TICK / self._step))(state, u)).ravel()

    def _input(self, command: VehicleCommand) -> FloatArray:
        sizes = input_sizes(self._vehicle)
        on_tractor = sizes.steer - len(command.trailer_steer)
        u = Input(
            steer=np.array([*[command.steer] * on_tractor, *command.trailer_steer]),
            acceleration=np.array([command.acceleration]),
            gear=np.array([command.gear]),
            friction=np.full(sizes.friction, self._friction),
            gravity_x=np.zeros(sizes.gravity_x),
            gravity_y=np.zeros(sizes.gravity_y),
            road=np.zeros(sizes.road),
        )
        return np.concatenate(u)


@lru_cache(maxsize=32)
def _steps(vehicle: Vehicle, step: float, count: int) -> Any:
    """Function (state, chain's input) -> state after ``count`` steps [s]."""
    x, u = ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("u", sum(input_sizes(vehicle)))

    def rate(state: ca.SX) -> ca.SX:
        return ca.cse(ca.vertcat(*derivative(vehicle, *_named(vehicle, state, u))))

    stiff = ca.vertcat(*relaxation(vehicle, *_named(vehicle, x, u)))
    one = ca.Function("step", [x, u], [ca.cse(semi_implicit_step(rate, x, step, stiff))])
    return one.fold(count) if count > 1 else one


def _named(vehicle: Vehicle, x: ca.SX, u: ca.SX) -> tuple[State[ca.SX], Input[ca.SX]]:
    return State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle)))
