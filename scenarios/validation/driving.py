"""Slow drives of the dynamic model: along a path with the driver, and around a circle with constant steer."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, Protocol

import numpy as np

from controllers.driver import PERIOD, PreviewDriver
from controllers.path import Path
from scenarios.assembly.tractor_data import tractor_guided_at
from sensors.instruments.navigation import DriverPerception
from vehicle.clock import TICK, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State, parts, state_sizes, wheels
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

GRIP: Final = Surface(friction=1.5)  # the largest possible: slip should vanish
CREEP: Final = 0.25  # [m/s]; on stiff tyres slip angles are about 1e-6 rad, and grow with the square of speed
_CONTROL: Final = to_ticks(PERIOD, "control period")
_SPEED_GAIN: Final = 1.0  # acceleration demand per speed error [1/s]: aperiodic with any driveline's lag
_SPEED_INTEGRAL: Final = 0.2  # [1/s2]: aperiodic with the gain above
_SLOWING: Final = 5.0  # time to slow down [s]: several time constants of the speed control
_HELD: Final = 100  # control period of the speed [ticks]


class PlantLike(Protocol):
    """The plant, or one with another step size."""

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State of the straight combination rolling freely at ``speed`` [m/s] with its tractor at X_WT."""
        ...

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """Ground truth for this state."""
        ...

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command."""
        ...


def poses_of(truths: list[Truth]) -> FloatArray:
    """x [m], y [m], psi [rad] of every unit over time, (n, N, 3)."""
    return np.array([now.poses for now in truths])


def along_path(
    vehicle: Vehicle, path: Path, reference: tuple[float, float], speed: float, *, plant: PlantLike | None = None
) -> list[Truth]:
    """Truth every 20 ms while the driver keeps a point of the tractor, in T [m], on the path to its end.

    The plant has friction ``GRIP`` by default.
    """
    driver = PreviewDriver(tractor_guided_at(vehicle, reference), path, speed)
    perception, memory, plant = DriverPerception(), driver.init(), plant or Plant(vehicle, GRIP)
    start = path.start @ Pose2(*reference, 0.0).inverse()
    state, idle = plant.initial_state(start, speed), (0.0,) * _steered_behind(vehicle)
    truths: list[Truth] = []
    while memory.station < path.length - 1e-6:
        truths.append(plant.observe(state, len(truths) * _CONTROL))
        memory, demand = driver.step(memory, truths[-1].tick, perception.sample(truths[-1]))
        state = plant.step(state, VehicleCommand(demand.steer, demand.acceleration, idle), _CONTROL)
    return truths


def round_circle(
    vehicle: Vehicle,
    radius: float,
    speed: float,
    distance: float,
    *,
    approach: float = 0.0,
    approach_speed_factor: float = 1.0,
    trailer_steer: tuple[float, ...] = (),
    surface: Surface = GRIP,
) -> list[Truth]:
    """Truth every 0.1 s over a ``distance`` [m] on a left-hand circle of the tractor's rear axle.

    The tractor starts on the circle, with the units behind it aligned with the hitch's velocity. The first ``approach``
    [m] are driven ``approach_speed_factor`` times as fast and are not returned.
    """
    plant = Plant(vehicle, surface)
    steer = math.atan(vehicle.units[0].steered_axles[0].x / radius)
    state = _on_circle(plant, vehicle, radius, approach_speed_factor * speed if approach else speed, steer)
    truths: list[Truth] = []
    travelled = -approach
    held = 0.0  # acceleration demand that works against scrubbing tyres, which hold up to their friction [m/s2]
    while travelled < distance:
        now = plant.observe(state, len(truths) * _HELD)
        if travelled >= 0.0:
            truths.append(now)
        v_x = now.velocities[0, 0]
        fast = approach_speed_factor * speed
        wanted = fast if travelled < -_SLOWING * fast else speed
        held += _SPEED_INTEGRAL * (wanted - v_x) * _HELD * TICK
        command = VehicleCommand(steer, _SPEED_GAIN * (wanted - v_x) + held, trailer_steer)
        state = plant.step(state, command, _HELD)
        travelled += v_x * _HELD * TICK
    return truths


def steered(vehicle: Vehicle, demand: Callable[[float], float], speed: float, duration: float) -> list[Truth]:
    """Truth every 20 ms under a steer demand [rad] over time [s], from straight running, on ``GRIP``."""
    plant = Plant(vehicle, GRIP)
    state, idle = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), (0.0,) * _steered_behind(vehicle)
    truths: list[Truth] = []
    for tick in range(0, round(duration / TICK) + 1, _CONTROL):
        truths.append(plant.observe(state, tick))
        acceleration = _SPEED_GAIN * (speed - truths[-1].velocities[0, 0])
        state = plant.step(state, VehicleCommand(demand(tick * TICK), acceleration, idle), _CONTROL)
    return truths


def _steered_behind(vehicle: Vehicle) -> int:
    return sum(len(unit.steered_axles) for unit in vehicle.units[1:])


def _on_circle(plant: Plant, vehicle: Vehicle, radius: float, speed: float, steer: float) -> FloatArray:
    """State of a tractor that turns with its rear axle on the circle; the towed units do not turn yet."""
    s = State(*parts(plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), state_sizes(vehicle)))
    towed = math.atan((vehicle.units[0].hitch_x or 0.0) / radius)
    hub = np.array([speed * (1.0 - (wheel.y / radius if wheel.unit == 0 else 0.0)) for wheel in wheels(vehicle)])
    radii = np.array([wheel.axle.wheel_radius for wheel in wheels(vehicle)])
    on_tractor = np.array([wheel.unit == 0 for wheel in wheels(vehicle)])
    ahead = np.where(on_tractor, [wheel.axle.x for wheel in wheels(vehicle)], 0.0) / radius * speed
    return np.concatenate(
        s._replace(
            psi=np.array([0.0, *[towed] * (len(vehicle.units) - 1)]),
            yaw_rate=np.array([speed / radius, *[0.0] * (len(vehicle.units) - 1)]),
            steer=np.array([steer, *[0.0] * (len(s.steer) - 1)]),
            omega=np.hypot(hub, ahead) / radii,
        )
    )
