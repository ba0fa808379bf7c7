"""Many vehicles stepped at once: for learning and for sweeps, where a plant's single states would take too long."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import place_function, start_function, step_function, wheel_function
from vehicle.combination.ground_inputs import SurfacesUnder, ticks_to_next_look
from vehicle.combination.kinematics import Places, place_sizes
from vehicle.combination.layout import State, state_sizes
from vehicle.combination.plant_inputs import demand_sizes, footing_sizes, spans
from vehicle.combination.symbolic import numbers, topology
from vehicle.combination.wheel_truth import WheelTruth, wheel_truth_sizes
from vehicle.engine.kernels import Engine, kernel_for_many
from vehicle.frames import FloatArray
from vehicle.sanity import are_sane
from vehicle.surface import Surface


class Motion(NamedTuple):
    """Where n vehicles are and how they move."""

    poses: FloatArray  # (n, N, 3) x [m], y [m], psi [rad] of each unit's frame in W
    velocities: FloatArray  # (n, N, 3) v_x, v_y [m/s] along the unit's axes, yaw rate [rad/s]
    articulation: FloatArray  # (n, N - 1) yaw of each unit less that of the one behind [rad]


class PlantBatch:
    """n vehicles on their surfaces, each with a row of the state; one batch per thread.

    Vehicles may differ in their numbers, not in how they are built; a surface is one for all or one for each. A vehicle
    whose state breaks, or whose demand is no number, gets a state that is not finite and keeps it, while the others go
    on: ``finite`` tells them apart. Ground that changes from place to place is looked up at the beginning of a call and
    every 0.1 m that the fastest vehicle goes; each surface by itself.

    Raises:
        ValueError: if vehicles, surfaces or engine do not fit.
    """

    def __init__(
        self,
        vehicles: Vehicle | Sequence[Vehicle],
        surfaces: Surface | Sequence[Surface],
        n: int,
        engine: Engine = "auto",
    ) -> None:
        if n < 1:
            raise ValueError(f"n = {n} vehicles must be at least 1")
        self._arguments = (vehicles, surfaces, n, engine)
        self._n = n
        self._vehicle, values = _built_alike(vehicles, n)
        self._advance = kernel_for_many(step_function(self._vehicle), values, n, engine)
        self._places = kernel_for_many(place_function(self._vehicle), values, n, engine)
        self._wheels = kernel_for_many(wheel_function(self._vehicle), values, n, engine)
        # What is asked for once in a run is not worth compiling.
        self._start = kernel_for_many(start_function(self._vehicle), values, n, "interpreted")
        self._under = SurfacesUnder(surfaces, self._vehicle, n)
        self._everywhere = self._under.everywhere
        self._n_trailer, self._n_demands = demand_sizes(self._vehicle).trailer_steer, sum(demand_sizes(self._vehicle))
        self._at = Places(*spans(place_sizes(self._vehicle)))
        self._of_wheels = WheelTruth(*spans(wheel_truth_sizes(self._vehicle)))
        in_state = State(*spans(state_sizes(self._vehicle)))
        self._velocity = [in_state.v_x.start, in_state.v_y.start]
        self._nothing = np.empty((n, 0))

    def __reduce__(self) -> tuple[type[PlantBatch], tuple[Any, ...]]:
        return (PlantBatch, self._arguments)  # memory does not travel: it is made anew

    def initial_state(self, poses: ArrayLike, speeds: ArrayLike) -> FloatArray:
        """States of straight combinations rolling freely: poses X_WT (n, 3) [m, rad] and speeds (n,) [m/s]."""
        start = np.empty((self._n, 4))
        start[:, :3], start[:, 3] = poses, speeds
        level = self._start(self._nothing, np.hstack([start, np.zeros((self._n, sum(footing_sizes(self._vehicle))))]))
        return self._start(self._nothing, np.hstack([start, self._footing(level)]))

    def step(
        self,
        state: FloatArray,
        steer: ArrayLike,
        acceleration: ArrayLike,
        trailer_steer: ArrayLike,
        ticks: int,
        gear: ArrayLike = 1.0,
    ) -> FloatArray:
        """States (n, n_state) after whole ticks under held demands, a new array.

        Steer (n,) of the tractors [rad], acceleration (n,) [m/s2], steer (n, n_steered) of the trailer axles [rad] and
        gear (n,): +1 forward, -1 backward.

        Raises:
            ValueError: if the number of ticks or the shape of the demands does not fit, or a gear is none.
        """
        if ticks < 1:
            raise ValueError(f"ticks = {ticks} must be at least 1 tick of {TICK * 1e3:g} ms")
        demands = self._demands(steer, acceleration, trailer_steer, gear)
        while ticks > 0:
            now = ticks if self._everywhere is not None else min(ticks, ticks_to_next_look(self._fastest(state)))
            state = self._advance(state, np.hstack([demands, self._footing(state)]), now)
            ticks -= now
        state[~np.isfinite(demands).all(axis=1)] = np.nan  # limits would take such a demand for their own
        return state

    def finite(self, state: FloatArray) -> NDArray[np.bool_]:
        """Which vehicles' states are sane, (n,): finite, and below 1e12 in any SI unit."""
        return are_sane(state)

    def observe_motion(self, state: FloatArray) -> Motion:
        """Where the vehicles are and how they move."""
        seen = self._places(state, self._nothing)
        poses = seen[:, self._at.poses].reshape(self._n, -1, 3)
        velocities = seen[:, self._at.velocities].reshape(self._n, -1, 3)
        return Motion(poses, velocities, poses[:, :-1, 2] - poses[:, 1:, 2])

    def observe_wheels(self, state: FloatArray) -> WheelTruth[FloatArray]:
        """What axles and wheels do, an array (n, ...) each."""
        idle = np.zeros((self._n, self._n_demands))  # no truth depends on a demand
        told = self._wheels(state, np.hstack([idle, self._footing(state)]))
        return WheelTruth(*(told[:, span] for span in self._of_wheels))

    def _demands(
        self, steer: ArrayLike, acceleration: ArrayLike, trailer_steer: ArrayLike, gear: ArrayLike
    ) -> FloatArray:
        of_trailers = np.asarray(trailer_steer, dtype=np.float64)
        if of_trailers.shape != (self._n, self._n_trailer):
            raise ValueError(
                f"trailer_steer of shape {of_trailers.shape} must be ({self._n}, {self._n_trailer}): "
                f"{self._vehicle.name} steers {self._n_trailer} trailer axles"
            )
        demands = np.empty((self._n, self._n_demands))
        demands[:, 0], demands[:, 1], demands[:, 2:-1], demands[:, -1] = steer, acceleration, of_trailers, gear
        if not (np.abs(demands[:, -1]) == 1.0).all():
            raise ValueError("gear must be 1 (forward) or -1 (backward) for every vehicle")
        return demands

    def _footing(self, state: FloatArray) -> FloatArray:
        if self._everywhere is not None:
            return self._everywhere
        places = self._places(state, self._nothing)
        lost = ~are_sane(places)
        if lost.any():
            places[lost] = 0.0  # taken as at the origin, for the ground is only at places
        return self._under.footing(places)

    def _fastest(self, state: FloatArray) -> float:
        speeds = np.linalg.norm(state[are_sane(state)][:, self._velocity], axis=1)
        return float(np.max(speeds, initial=0.0))


def _built_alike(vehicles: Vehicle | Sequence[Vehicle], n: int) -> tuple[Vehicle, FloatArray]:
    """A vehicle that stands for all, and their numbers: of one for all, or a row for each."""
    if isinstance(vehicles, Vehicle):
        return vehicles, numbers(vehicles)
    if len(vehicles) != n:
        raise ValueError(f"{len(vehicles)} vehicles for a batch of {n}: there must be one for all or one for each")
    first = topology(vehicles[0])
    for vehicle in vehicles:
        if topology(vehicle) != first:
            raise ValueError(f"{vehicle.name} and {vehicles[0].name} are built differently and can not share a batch")
    return vehicles[0], np.array([numbers(vehicle) for vehicle in vehicles])
