"""Steering laws as pilots of ``TrailerSteering``.

A law gets the observed estimate and signals, and the hitch path at the time of the estimate: the true path plus the
estimate's error, which grows linearly from hitch to follow point as in the surrogate.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.trailer import Combination, TrailerSteering
from controllers.trailer_steering.policy import feature_names
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.hitch_path import crossing, tangent
from offtrack.environments.observations import Mark
from offtrack.environments.trailer_steering import TrailerSteering as TrailerSteeringCore
from scenarios.assembly.adapters import trailer_geometry
from scenarios.assembly.drivers_and_laws import trailer_law
from scenarios.assembly.surrogate import SurrogateParameters
from sensors.messages import CombinationSignals
from vehicle.clock import TICK, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.foundation.own_parts import close_part
from vehicle.frames import FloatArray, arc_length
from vehicle.option import Parameter

_KEPT: Final = 60  # control steps: age of the oldest usable estimate
_FITTED: Final = 1.0  # of path behind the hitch, to fit its direction [m]
_BEYOND: Final = 1.5  # of path behind the follow point, for the fits around it [m]


class _Lane(NamedTuple):
    """Law of one episode."""

    law: TrailerSteering[Any]
    memory: Any
    follow_distance: float
    estimate: OffTracking | None


class LawPilot:
    """Pilot that steers all episodes of a core by laws of one name."""

    def __init__(
        self,
        core: TrailerSteeringCore,
        vehicle: Vehicle,
        law: str,
        errors: SurrogateParameters,
        parameters: Mapping[str, Parameter] = MappingProxyType({}),
    ) -> None:
        """``errors`` give the standard deviation of the estimates, ``parameters`` are the law's.

        Raises:
            ValueError: one line, if the law is unknown, or cannot steer this vehicle.
        """
        self._core, self._vehicle, self._law, self._parameters = core, vehicle, law, parameters
        self._std = float(np.sqrt(errors.bias**2 + errors.drift**2 + errors.noise**2))
        self._geometry = trailer_geometry(vehicle, len(vehicle.units) - 1)
        n_steered = len(self._geometry.steered_distances)
        names = feature_names(n_steered, [unit.name for unit in vehicle.units])
        self._column = {name: k for k, name in enumerate(names)}
        self._axles = [names.index(f"steer_trailer_{k + 1}") for k in range(n_steered)]
        self._articulation = [k for k, name in enumerate(names) if name.startswith("articulation_")]
        self._yaw_rates = [k for k, name in enumerate(names) if name.startswith("yaw_rate_")]
        self._period = to_ticks(1.0 / core.control_rate, "control period")
        self._marks: deque[tuple[int, Mark]] = deque(maxlen=_KEPT)
        self._tick = 0
        self._lanes: list[_Lane] = []

    def begin(self, observation: NDArray[np.float32]) -> None:
        """Begin episodes in all lanes, with their first observation (n, n_features)."""
        self.close()
        self._tick = 0
        self._marks.clear()
        self._lanes = [self._opened(float(row[self._column["follow_distance"]])) for row in observation]

    def act(self, observation: NDArray[np.float32], going: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Actions (n, n_steered) for an observation, once per control step; 0 for episodes that are over."""
        self._marks.append((self._tick, self._core.hitch_paths.mark()))
        actions = np.zeros((len(observation), len(self._axles)), dtype=np.float32)
        for k in np.flatnonzero(going).tolist():
            row = observation[k].astype(np.float64)
            lane = self._updated(k, row)
            memory, command = lane.law.step(lane.memory, self._tick, lane.estimate, self._signals(row))
            self._lanes[k] = lane._replace(memory=memory)
            actions[k] = command.angles / self._geometry.max_steer
        self._tick += self._period
        return actions

    def close(self) -> None:
        """Close the laws of all episodes."""
        for lane in self._lanes:
            close_part(lane.law)
        self._lanes = []

    def _opened(self, follow_distance: float) -> _Lane:
        longer = follow_distance - self._geometry.follow_distance  # the axles have moved with the trailer's end
        distances = tuple(distance + longer for distance in self._geometry.axle_distances)
        geometry = replace(self._geometry, follow_distance=follow_distance, axle_distances=distances)
        combination = Combination(self._vehicle, len(self._vehicle.units) - 1)
        law = trailer_law(self._law, geometry, combination, self._parameters)
        return _Lane(law, law.init(), follow_distance, None)

    def _updated(self, k: int, row: FloatArray) -> _Lane:
        """The lane with the estimate of an observation's row, if that is a new one."""
        lane = self._lanes[k]
        usable = row[self._column["usable"]] > 0.5
        tick = self._tick - round(float(row[self._column["age"]]) / TICK)
        known = lane.estimate
        if known is not None and tick <= known.tick:
            if not usable and known.health is not Health.LOST:
                lane = lane._replace(estimate=replace(known, health=Health.LOST, std=np.inf))
            return lane
        mark = next((mark for at, mark in self._marks if at >= tick), None)
        if mark is None:
            return lane
        return lane._replace(estimate=self._estimate(k, row, tick, mark, lane.follow_distance))

    def _estimate(self, k: int, row: FloatArray, tick: int, mark: Mark, follow: float) -> OffTracking:
        at = self._column
        path = self._core.hitch_paths.behind(k, mark, follow + _BEYOND)
        s = arc_length(path)
        passed = crossing(path, s, -follow)
        value = float(row[at["off_tracking"]])
        if passed is not None:
            path = path + np.column_stack([np.zeros(len(s)), (value - passed.y) * s / passed.s])
        v_x, v_y, yaw_rate = (float(row[at[name]]) for name in ("hitch_v_x", "hitch_v_y", "trailer_yaw_rate"))
        at_hitch = tangent(path, s, 0.0, _FITTED)
        return OffTracking(
            tick=tick,
            value=value,
            std=self._std,
            health=Health.OK,
            path=path,
            hitch_direction=at_hitch.direction,
            hitch_direction_rate=at_hitch.curvature * float(np.hypot(v_x, v_y)) - yaw_rate,
            path_tangent=float(row[at["path_direction"]]),
            v_x=v_x,
            v_y=v_y,
            yaw_rate=yaw_rate,
        )

    def _signals(self, row: FloatArray) -> CombinationSignals:
        at = self._column
        speed, turning = float(row[at["speed"]]), float(row[self._yaw_rates[-1]])
        return CombinationSignals(
            tick=self._tick,
            angles=row[self._axles],
            speed=speed,
            steer=float(row[at["steer_tractor"]]),
            articulation=row[self._articulation],
            yaw_rates=row[self._yaw_rates],
            lateral_acceleration=speed * turning,  # steady turn: the observation has no accelerometer
        )
