"""The vehicle as it really moves: its equations stepped over whole ticks on a surface."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import body_function, place_function, start_function, step_function, wheel_function
from vehicle.combination.ground_inputs import SurfaceUnder, ticks_to_next_look
from vehicle.combination.kinematics import Places, place_sizes
from vehicle.combination.layout import State, state_sizes
from vehicle.combination.plant_inputs import demand_sizes, footing_sizes, spans
from vehicle.combination.symbolic import numbers
from vehicle.combination.truth import Truth
from vehicle.combination.wheel_truth import WheelTruth, wheel_truth_sizes
from vehicle.engine.kernels import Engine, kernel_for_one
from vehicle.frames import FloatArray, Pose2
from vehicle.sanity import is_sane
from vehicle.surface import Surface

_NOTHING: Final = np.empty(0)


class VehicleCommand(NamedTuple):
    """What driver and trailer controllers demand of the vehicle."""

    steer: float  # of the tractor's foremost steered axle [rad]
    acceleration: float  # above 0 drives the way the gear does, below 0 brakes [m/s2]
    trailer_steer: tuple[float, ...]  # of every steered trailer axle, front to rear [rad]
    gear: float = 1.0  # +1 forward, -1 backward; it is in at once, so change it at a standstill


class DivergedError(Exception):
    """The physics broke: a step led to a state that is not finite, or astronomic."""

    def __init__(self, state: FloatArray, u: FloatArray) -> None:
        super().__init__(f"the state is no longer sane after a step from state {state} with input {u}")
        self.state = state
        self.input = u


class Plant:
    """A vehicle on a surface, compiled or interpreted; one per thread.

    Where the ground changes from place to place, it is looked up at the beginning of a call and every 0.1 m.
    """

    def __init__(self, vehicle: Vehicle, surface: Surface, engine: Engine = "auto") -> None:
        self._vehicle, self._surface, self._engine = vehicle, surface, engine
        values = numbers(vehicle)
        self._under = SurfaceUnder(surface, vehicle)
        self._everywhere = self._under.everywhere
        always = _NOTHING if self._everywhere is None else self._everywhere
        self._advance = kernel_for_one(step_function(vehicle), values, engine, always=always)
        # What is asked now and then is interpreted: a call costs more than its arithmetic.
        self._places = kernel_for_one(place_function(vehicle), values, "interpreted")
        self._wheels = kernel_for_one(wheel_function(vehicle), values, "interpreted")
        self._bodies = kernel_for_one(body_function(vehicle), values, "interpreted")
        self._start = kernel_for_one(start_function(vehicle), values, "interpreted")
        self._n_trailer = demand_sizes(vehicle).trailer_steer
        self._idle = np.zeros(sum(demand_sizes(vehicle)))
        self._at = Places(*spans(place_sizes(vehicle)))
        self._of_wheels = WheelTruth(*spans(wheel_truth_sizes(vehicle)))
        in_state = State(*spans(state_sizes(vehicle)))
        self._velocity = [in_state.v_x.start, in_state.v_y.start]

    def __reduce__(self) -> tuple[type[Plant], tuple[Vehicle, Surface, Engine]]:
        return (Plant, (self._vehicle, self._surface, self._engine))  # memory does not travel: it is made anew

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State of the straight combination rolling freely at ``speed`` [m/s] with its tractor at X_WT."""
        start = (*pose, speed)
        level = self._start(_NOTHING, np.array([*start, *np.zeros(sum(footing_sizes(self._vehicle)))]))
        return self._start(_NOTHING, np.array([*start, *self._footing(self._seen(level))]))

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command, a new array.

        Raises:
            ValueError: if the number of ticks or of trailer steer demands does not fit, a demand is not finite, or the
                gear is none.
            DivergedError: if the new state is not finite, or beyond 1e12 in any SI unit.
        """
        if ticks < 1:
            raise ValueError(f"ticks = {ticks} must be at least 1 tick of {TICK * 1e3:g} ms")
        demands = self._demands(command)
        if self._everywhere is not None:
            return self._stepped(state, np.concatenate([demands, self._everywhere]), ticks)
        while ticks > 0:
            u = np.concatenate([demands, self._footing(self._seen(state))])
            before_next_look = min(ticks, ticks_to_next_look(math.hypot(*state[self._velocity].tolist())))
            state = self._stepped(state, u, before_next_look)
            ticks -= before_next_look
        return state

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """What is really so in this state."""
        seen = self._seen(state)
        idle = np.concatenate([self._idle, self._footing(seen)])  # no truth depends on a demand
        at, of_wheels, told = self._at, self._of_wheels, self._wheels(state, idle)
        return Truth(
            tick=tick,
            poses=seen[at.poses].reshape(-1, 3),
            velocities=seen[at.velocities].reshape(-1, 3),
            bodies=self._bodies(state, self._under.ground(seen)).reshape(-1, 4, 4),
            steer=told[of_wheels.steer],
            wheel_loads=told[of_wheels.loads],
            wheel_slip_angles=told[of_wheels.slip_angles],
            friction_used=told[of_wheels.friction_used],
            load_transfer=told[of_wheels.load_transfer],
        )

    def _stepped(self, state: FloatArray, u: FloatArray, ticks: int) -> FloatArray:
        after = self._advance(state, u, ticks)
        if not is_sane(after):
            raise DivergedError(state, u)
        return after

    def _demands(self, command: VehicleCommand) -> tuple[float, ...]:
        demands = (command.steer, command.acceleration, *command.trailer_steer, command.gear)
        if len(demands) != len(self._idle):
            raise ValueError(
                f"trailer_steer has {len(command.trailer_steer)} angles, "
                f"{self._vehicle.name} steers {self._n_trailer} trailer axles"
            )
        if not math.isfinite(sum(demands)):
            raise ValueError(f"{command} must be of finite numbers [rad, m/s2]")
        if command.gear not in (1.0, -1.0):
            raise ValueError(f"gear = {command.gear} must be 1 (forward) or -1 (backward)")
        return demands

    def _seen(self, state: FloatArray) -> FloatArray:
        """``Places``; a state that is no number is taken as at the origin, for the ground is only at places."""
        places = self._places(state, _NOTHING)
        return places if is_sane(places) else np.zeros_like(places)

    def _footing(self, places: FloatArray) -> FloatArray:
        return self._under.footing(places) if self._everywhere is None else self._everywhere
