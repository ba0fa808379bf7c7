"""The simulated combination: its equations stepped over whole ticks on a surface."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import (
    body_function,
    kinematics_function,
    start_function,
    step_function,
    wheel_function,
)
from vehicle.combination.ground_inputs import SurfaceLookup, ticks_to_next_lookup
from vehicle.combination.layout import State, state_sizes
from vehicle.combination.plant_inputs import command_sizes, ground_input_sizes, slices
from vehicle.combination.symbolic import numbers
from vehicle.combination.truth import Truth
from vehicle.combination.truth_vectors import TruthAssembly
from vehicle.engine.kernels import Engine, kernel_for_one
from vehicle.frames import FloatArray, Pose2
from vehicle.sanity import is_sane
from vehicle.surface import Surface

_NOTHING: Final = np.empty(0)


class VehicleCommand(NamedTuple):
    """Command of the driver and the trailer controllers."""

    steer: float  # of the tractor's foremost steered axle [rad]
    acceleration: float  # above 0 drives the way the gear does, below 0 brakes [m/s2]
    trailer_steer: tuple[float, ...]  # of every steered trailer axle, front to rear [rad]
    gear: float = 1.0  # +1 forward, -1 backward; takes effect at once, so change it at a standstill
    brake_share: tuple[float, ...] = ()  # of each wheel's brake torque that acts, of a vehicle ``with_failing_brakes``


class DivergedError(Exception):
    """A step led to a state that is not finite, or beyond 1e12 in any SI unit."""

    def __init__(self, state: FloatArray, u: FloatArray) -> None:
        super().__init__(f"the state diverged in a step from state {state} with input {u}")
        self.state = state
        self.input = u


class Plant:
    """A vehicle on a surface, compiled or interpreted; one per thread.

    Ground that changes with position is looked up at the beginning of a call and every 0.1 m.
    """

    def __init__(self, vehicle: Vehicle, surface: Surface, engine: Engine = "auto") -> None:
        self._vehicle, self._surface, self._engine = vehicle, surface, engine
        if surface.gust is not None:
            vehicle = vehicle.in_wind()
            self._vehicle = vehicle
        values = numbers(vehicle)
        self._lookup = SurfaceLookup(surface, vehicle)
        self._constant_ground = self._lookup.constant
        always = _NOTHING if self._constant_ground is None else self._constant_ground
        self._advance = kernel_for_one(step_function(vehicle), values, engine, always=always)
        # Interpreted where it is called rarely: a call costs more than its arithmetic.
        self._kinematics = kernel_for_one(kinematics_function(vehicle), values, "interpreted")
        self._wheels = kernel_for_one(wheel_function(vehicle), values, "interpreted")
        self._bodies = kernel_for_one(body_function(vehicle), values, "interpreted")
        self._start = kernel_for_one(start_function(vehicle), values, "interpreted")
        self._assembly = TruthAssembly(vehicle)
        self._n_trailer = command_sizes(vehicle).trailer_steer
        self._sound_brakes = (1.0,) * command_sizes(vehicle).brake_share
        self._known: tuple[bytes, FloatArray] = b"", _NOTHING  # state last observed, and its ground inputs
        self._idle = np.zeros(sum(command_sizes(vehicle)))
        in_state = State(*slices(state_sizes(vehicle)))
        self._velocity = [in_state.v_x.start, in_state.v_y.start]

    def __reduce__(self) -> tuple[type[Plant], tuple[Vehicle, Surface, Engine]]:
        return (Plant, (self._vehicle, self._surface, self._engine))  # compiled functions cannot be pickled

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State of the straight combination rolling freely at ``speed`` [m/s] with its tractor at X_WT."""
        start = (*pose, speed)
        level = self._start(_NOTHING, np.array([*start, *np.zeros(sum(ground_input_sizes(self._vehicle)))]))
        return self._start(_NOTHING, np.array([*start, *self._ground_inputs(self._kinematics_of(level))]))

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command, a new array.

        Raises:
            ValueError: if the number of ticks or of trailer steer angles does not fit, a value is not finite, or the
                gear is neither 1 nor -1.
            DivergedError: if the new state is not finite, or beyond 1e12 in any SI unit.
        """
        if ticks < 1:
            raise ValueError(f"ticks = {ticks} must be at least 1 tick of {TICK * 1e3:g} ms")
        inputs = self._command_inputs(command)
        if self._constant_ground is not None:
            return self._stepped(state, np.concatenate([inputs, self._constant_ground]), ticks)
        while ticks > 0:
            u = np.concatenate([inputs, self._ground_under(state)])
            before_next_lookup = min(ticks, ticks_to_next_lookup(math.hypot(*state[self._velocity].tolist())))
            state = self._stepped(state, u, before_next_lookup)
            ticks -= before_next_lookup
        return state

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """Ground truth of this state."""
        kinematics = self._kinematics_of(state)
        self._known = state.tobytes(), self._ground_inputs(kinematics)
        inputs = np.concatenate([self._idle, self._known[1]])  # no truth depends on a command
        bodies = self._bodies(state, self._lookup.smooth_ground(kinematics))
        return self._assembly.truth(tick, kinematics, self._wheels(state, inputs), bodies)

    def _stepped(self, state: FloatArray, u: FloatArray, ticks: int) -> FloatArray:
        after = self._advance(state, u, ticks)
        if not is_sane(after):
            raise DivergedError(state, u)
        return after

    def _command_inputs(self, command: VehicleCommand) -> tuple[float, ...]:
        shares = command.brake_share or self._sound_brakes
        inputs = (command.steer, command.acceleration, *command.trailer_steer, command.gear, *shares)
        if len(command.trailer_steer) != self._n_trailer:
            raise ValueError(
                f"trailer_steer has {len(command.trailer_steer)} angles, "
                f"{self._vehicle.name} steers {self._n_trailer} trailer axles"
            )
        if len(shares) != len(self._sound_brakes):
            raise ValueError(f"brake_share has {len(shares)} numbers, not {len(self._sound_brakes)}")
        if not math.isfinite(sum(inputs)):
            raise ValueError(f"{command} must be of finite numbers [rad, m/s2]")
        if command.gear not in (1.0, -1.0):
            raise ValueError(f"gear = {command.gear} must be 1 (forward) or -1 (backward)")
        return inputs

    def _kinematics_of(self, state: FloatArray) -> FloatArray:
        """``Kinematics``; of a diverged state those at the origin, as the ground has no height elsewhere."""
        kinematics = self._kinematics(state, _NOTHING)
        return kinematics if is_sane(kinematics) else np.zeros_like(kinematics)

    def _ground_under(self, state: FloatArray) -> FloatArray:
        """Ground inputs of a state, looked up once where it is observed and then stepped from."""
        of_state, ground = self._known
        return ground if state.tobytes() == of_state else self._ground_inputs(self._kinematics_of(state))

    def _ground_inputs(self, kinematics: FloatArray) -> FloatArray:
        return self._lookup.ground_inputs(kinematics) if self._constant_ground is None else self._constant_ground
