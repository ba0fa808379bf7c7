"""The numbers of a vehicle whose last trailer has another load, length and steering lag."""

from __future__ import annotations

import numpy as np

from scenarios.environments.domain import Circumstances
from vehicle.combination.description import Vehicle
from vehicle.combination.symbolic import symbolic_twin
from vehicle.frames import FloatArray


class Variation:
    """Rows of a vehicle's numbers, varied: axles move with the trailer's end and keep their spacing."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Of the vehicle's last unit."""
        twin = symbolic_twin(vehicle)
        last = f"units.{len(vehicle.units) - 1}."
        places = {str(twin.symbols[k]): k for k in range(twin.symbols.numel())}
        self._nominal = twin.values
        self._mass, self._inertia = places[last + "mass"], places[last + "yaw_inertia"]
        self._lag = [places[name] for name in (last + "steering.lag",) if name in places]
        self._cg = places[last + "cg_x"]
        trailer = vehicle.units[-1]
        axles = range(len(trailer.axles))
        moved = [f"{last}axles.{k}.{name}" for k in axles for name in ("x", "ackermann_x")]
        self._moved = [places[name] for name in (*moved, last + "follow_x", last + "rear_x") if name in places]
        follow = trailer.follow_x or trailer.rear_x
        self._follow = -follow
        self._centre = -sum(axle.x for axle in trailer.axles) / len(trailer.axles)

    def follow_distance(self, drawn: Circumstances) -> FloatArray:
        """Hitch to follow point, (k,) [m]."""
        return self._follow * drawn.length

    def numbers(self, drawn: Circumstances) -> FloatArray:
        """The numbers (k, n_numbers) of these vehicles.

        The load stays in the middle between hitch and axles as it was, so that both keep their shares of it.
        """
        rows = np.tile(self._nominal, (len(drawn.load), 1))
        longer = (drawn.length - 1.0) * self._follow
        rows[:, self._moved] -= longer[:, None]
        rows[:, self._cg] *= 1.0 + longer / self._centre
        rows[:, self._mass] *= drawn.load
        rows[:, self._inertia] *= drawn.load * drawn.length**2
        rows[:, self._lag] *= drawn.actuator_lag[:, None]
        return rows
