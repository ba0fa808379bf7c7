"""Steering actuators before a plant FMU: those of the data sheet, for axles whose angles the FMU does not give.

Models of other tools often take the angles of the road wheels as they are. Drivers and laws are designed for lag and
limits of the data sheet, and the monitor of the actuators expects them: with axles that jump the loop would oscillate.
"""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from controllers.actuator import settle
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import steering_actuators, turned_axles
from vehicle.combination.plant import VehicleCommand
from vehicle.frames import FloatArray


class SteeringActuators:
    """Actuators of a vehicle's steered axles, which are counted front to rear, from the tractor's on."""

    def __init__(self, vehicle: Vehicle, given: Container[str]) -> None:
        """For the axles whose ``steer_angle_1``, ``steer_angle_2``, … are not among the FMU's ``given`` outputs."""
        self._n_tractor = len(vehicle.units[0].steered_axles)
        self._n_driver = len(vehicle.units[0].actuators)
        self._actuators = tuple(zip(steering_actuators(vehicle), turned_axles(vehicle), strict=True))
        self._n_axles = sum(len(turned) for _, turned in self._actuators)
        self._given = np.array([f"steer_angle_{k}" in given for k in range(1, self._n_axles + 1)], dtype=bool)

    def straight(self) -> FloatArray:
        """Angles (n_steered,) at the start [rad]."""
        return np.zeros(self._n_axles)

    def turned(self, angles: FloatArray, command: VehicleCommand, duration: float) -> FloatArray:
        """Angles (n_steered,) [rad] after a command was held for ``duration`` [s]; of given axles the demands."""
        demands = self._demands(command)
        after = np.empty(self._n_axles)
        for steering, axles in self._actuators:
            demand = np.mean([demands[axle] / ratio for axle, ratio in axles])
            demand = np.clip(demand, -steering.limit, steering.limit)
            for axle, ratio in axles:
                settled = settle(angles[axle] / ratio, demand, duration, lag=steering.lag, max_rate=steering.rate_limit)
                after[axle] = ratio * float(settled)
        return np.where(self._given, demands, after)

    def _demands(self, command: VehicleCommand) -> FloatArray:
        """Demands of the axles (n_steered,): the driver's turns the first axle of each of the tractor's actuators."""
        demands = np.concatenate([np.empty(self._n_tractor), command.trailer_steer])
        for _, axles in self._actuators[: self._n_driver]:
            for axle, ratio in axles:
                demands[axle] = command.steer * ratio / axles[0][1]
        return demands

    def command(self, command: VehicleCommand, angles: FloatArray) -> VehicleCommand:
        """The command with angles of the axles in the place of demands."""
        return command._replace(steer=float(angles[0]), trailer_steer=tuple(angles[self._n_tractor :].tolist()))
