"""Stops under one brake demand, straight or with a fixed steering wheel: speeds, slips and pressures over time."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State, parts, state_sizes, wheels
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

PERIOD: Final = 10  # of the rows [ticks]
ROW: Final = 0.01  # [s]
_STANDS: Final = 0.05  # [m/s]


class Stop(NamedTuple):
    """A drive under one brake demand, a row every 10 ms."""

    speed: FloatArray  # (n,) [m/s]
    distance: FloatArray  # (n,) [m]
    tread: FloatArray  # (n, n_wheels) speed of every tread [m/s]
    pressure: FloatArray  # (n, n_channels) [-]
    articulation: FloatArray  # (n, N - 1) [rad]
    lateral: FloatArray  # (n,) [m]

    def slips(self, above: float, after: float = 1.0) -> FloatArray:
        """Slips [-], (n, n_wheels), at speeds above a bound [m/s] and ``after`` some seconds."""
        rows = (self.speed > above) & (np.arange(len(self.speed)) * ROW > after)
        slips: FloatArray = 1.0 - self.tread[rows] / self.speed[rows, None]
        return slips

    def deceleration(self, fast: float, slow: float) -> float:
        """Mean deceleration [m/s2] between two speeds [m/s]."""
        first, last = (int(np.argmax(self.speed < bound)) for bound in (fast, slow))
        return float(self.speed[first] - self.speed[last]) / (ROW * (last - first))


def braked(
    vehicle: Vehicle, surface: Surface, speed: float, demand: float, *, steer: float = 0.0, seconds: float = 30.0
) -> Stop:
    """Brake from ``speed`` [m/s] with ``demand`` [m/s2] until it stands, under a fixed steering wheel."""
    plant, layout = Plant(vehicle, surface), wheels(vehicle)
    radii = np.array([wheel.axle.wheel_radius for wheel in layout])
    command = VehicleCommand(steer, -demand, (0.0,) * sum(len(unit.steered_axles) for unit in vehicle.units[1:]))
    state, rows = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), []
    for _ in range(round(seconds / ROW)):
        s = State(*parts(state, state_sizes(vehicle)))
        rows.append((s.v_x[0], s.x[0], s.omega * radii, s.brake_pressure, s.psi[:-1] - s.psi[1:], s.y[0]))
        if s.v_x[0] < _STANDS:
            break
        state = plant.step(state, command, PERIOD)
    return Stop(*(np.array(column) for column in zip(*rows, strict=True)))


def without_abs(vehicle: Vehicle) -> Vehicle:
    """The vehicle with its ABS switched off."""
    if vehicle.brakes is None:
        return vehicle
    return vehicle.model_copy(update={"brakes": vehicle.brakes.model_copy(update={"abs": False})})
