"""Variation of a vehicle: its numbers with another load, length and steering lag of the last trailer."""

from __future__ import annotations

import numpy as np

from scenarios.environments.domain import Circumstances
from vehicle.combination.description import Vehicle
from vehicle.combination.symbolic import symbolic_twin
from vehicle.frames import FloatArray


class Variation:
    """Varied numbers of a vehicle: axles move with the trailer's end and keep their spacing."""

    def __init__(self, vehicle: Vehicle) -> None:
        """For the vehicle's last unit."""
        twin = symbolic_twin(vehicle)
        last = f"units.{len(vehicle.units) - 1}."
        index = {str(twin.symbols[k]): k for k in range(twin.symbols.numel())}
        self._nominal = twin.values
        self._mass, self._inertia = index[last + "mass"], index[last + "yaw_inertia"]
        self._roll = [index[name] for name in (last + "roll.inertia",) if name in index]
        self._lag = [index[name] for name in (last + "steering.lag",) if name in index]
        self._cg = index[last + "cg_x"]
        trailer = vehicle.units[-1]
        axles = range(len(trailer.axles))
        moved = [f"{last}axles.{k}.{name}" for k in axles for name in ("x", "ackermann_x")]
        self._moved = [index[name] for name in (*moved, last + "follow_x", last + "rear_x") if name in index]
        follow = trailer.follow_x or trailer.rear_x
        self._follow = -follow
        self._centre = -sum(axle.x for axle in trailer.axles) / len(trailer.axles)

    def follow_distance(self, drawn: Circumstances) -> FloatArray:
        """Hitch to follow point, (k,) [m]."""
        return self._follow * drawn.length

    def numbers(self, drawn: Circumstances) -> FloatArray:
        """Numbers (k, n_numbers) of these vehicles.

        The load keeps its relative position between hitch and axles, and so its distribution.
        """
        rows = np.tile(self._nominal, (len(drawn.load), 1))
        longer = (drawn.length - 1.0) * self._follow
        rows[:, self._moved] -= longer[:, None]
        rows[:, self._cg] *= 1.0 + longer / self._centre
        rows[:, self._mass] *= drawn.load
        rows[:, self._inertia] *= drawn.load * drawn.length**2
        rows[:, self._roll] *= drawn.load[:, None]
        rows[:, self._lag] *= drawn.actuator_lag[:, None]
        return rows
