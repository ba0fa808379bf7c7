"""Single vehicles of a fleet, as sensors sample them: what a plant says of its own one."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from scenarios.environments.fleet import Fleet
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import body_function, place_function, wheel_function
from vehicle.combination.ground_inputs import SurfaceUnder
from vehicle.combination.kinematics import Places, place_sizes
from vehicle.combination.layout import State, state_sizes
from vehicle.combination.plant_inputs import spans
from vehicle.combination.truth import Truth
from vehicle.combination.wheel_truth import WheelTruth, wheel_truth_sizes
from vehicle.frames import FloatArray

_NOTHING: Final = np.empty(0)


class FleetTruth:
    """Looks at the vehicles of a fleet one by one."""

    def __init__(self, vehicle: Vehicle, fleet: Fleet) -> None:
        """Of a fleet of vehicles built like this one."""
        self._fleet = fleet
        self._places, self._wheels, self._bodies = (f(vehicle) for f in (place_function, wheel_function, body_function))
        self._at = Places(*spans(place_sizes(vehicle)))
        self._of_wheels = WheelTruth(*spans(wheel_truth_sizes(vehicle)))
        in_state = State(*spans(state_sizes(vehicle)))
        self._x, self._y, self._psi = in_state.x.start, in_state.y.start, in_state.psi.start

    def of(self, lane: int, ground: SurfaceUnder, tick: int, *, back: float = 0.0) -> Truth:
        """What is really so of a vehicle on this ground; ``back``: if it stood so far behind where it is [m]."""
        state, given, own = self._fleet.alone(lane)
        if back:
            state = state.copy()
            state[self._x] -= back * np.cos(state[self._psi])
            state[self._y] -= back * np.sin(state[self._psi])
        places, wheels = _called(self._places, state, _NOTHING, own), _called(self._wheels, state, given, own)
        bodies = _called(self._bodies, state, ground.ground(places), own)
        at, of_wheels = self._at, self._of_wheels
        return Truth(
            tick=tick,
            poses=places[at.poses].reshape(-1, 3),
            velocities=places[at.velocities].reshape(-1, 3),
            bodies=bodies.reshape(-1, 4, 4),
            steer=wheels[of_wheels.steer],
            wheel_loads=wheels[of_wheels.loads],
            wheel_slip_angles=wheels[of_wheels.slip_angles],
            friction_used=wheels[of_wheels.friction_used],
            load_transfer=wheels[of_wheels.load_transfer],
        )


def _called(function: Any, *arguments: FloatArray) -> FloatArray:
    found: FloatArray = function(*arguments).full().ravel()
    return found
