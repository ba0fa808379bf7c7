"""Braked combinations for tests: without ABS, and a full stop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State, parts, state_sizes, wheels
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface


def without_abs(vehicle: Vehicle) -> Vehicle:
    assert vehicle.brakes is not None
    return vehicle.model_copy(update={"brakes": vehicle.brakes.model_copy(update={"abs": False})})


def without_governor(vehicle: Vehicle) -> Vehicle:
    """Whose wheels spin as fast as the engine's power turns them."""
    return vehicle.model_copy(update={"powertrain": None})


class Stop(NamedTuple):
    """A drive under one brake demand, a row every 10 ms."""

    speed: FloatArray  # (n,) [m/s]
    distance: FloatArray  # (n,) [m]
    tread: FloatArray  # (n, n_wheels) speed of every tread [m/s]
    pressure: FloatArray  # (n, n_channels) [-]
    articulation: FloatArray  # (n, N - 1) [rad]
    lateral: FloatArray  # (n,) [m]

    def slips(self, above: float, after: float = 1.0) -> FloatArray:
        """Slips [-] at speeds above a bound [m/s], ``after`` [s]."""
        rows = (self.speed > above) & (np.arange(len(self.speed)) > 100 * after)
        return 1.0 - self.tread[rows] / self.speed[rows, None]


def braked(
    vehicle: Vehicle, surface: Surface, speed: float, demand: float, *, steer: float = 0.0, seconds: float = 30.0
) -> Stop:
    """Brake from ``speed`` [m/s] with ``demand`` [m/s2] until it stands, under a fixed steering wheel."""
    plant, layout = Plant(vehicle, surface), wheels(vehicle)
    radii = np.array([wheel.axle.wheel_radius for wheel in layout])
    command = VehicleCommand(steer, -demand, (0.0,) * sum(len(unit.steered_axles) for unit in vehicle.units[1:]))
    state, rows = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), []
    for _ in range(round(100 * seconds)):
        s = State(*parts(state, state_sizes(vehicle)))
        rows.append((s.v_x[0], s.x[0], s.omega * radii, s.brake_pressure, s.psi[:-1] - s.psi[1:], s.y[0]))
        if s.v_x[0] < 0.05:
            break
        state = plant.step(state, command, 10)
    return Stop(*(np.array(column) for column in zip(*rows, strict=True)))
