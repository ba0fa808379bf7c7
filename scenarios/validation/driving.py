"""The dynamic model driven slowly: along a path by the driver, and round a circle with the steering held."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, Protocol

import numpy as np

from controllers.driver import PERIOD, PreviewDriver, TractorGeometry
from controllers.path import Path
from sensors.instruments.navigation import DriverPerception
from vehicle.clock import TICK, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State, parts, state_sizes, wheels
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

GRIP: Final = Surface(friction=1.5)  # the highest there is: slip is to vanish
CREEP: Final = 0.25  # [m/s]; on stiff tyres slip angles are some 1e-6 rad here, and grow with the square of speed
_CONTROL: Final = to_ticks(PERIOD, "control period")
_SPEED_GAIN: Final = 1.0  # acceleration demand per speed error [1/s]: aperiodic with any driveline's lag
_SLOWING: Final = 5.0  # time to become slow in [s]: some of the speed's own time constants
_HELD: Final = 100  # ticks between two looks at the speed where only the speed is controlled


class Motive(Protocol):
    """What moves: the plant, or one that takes other steps."""

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State of the straight combination rolling freely at ``speed`` [m/s] with its tractor at X_WT."""
        ...

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """What is really so in this state."""
        ...

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command."""
        ...


def poses_of(seen: list[Truth]) -> FloatArray:
    """x [m], y [m], psi [rad] of every unit over time, (n, N, 3)."""
    return np.array([now.poses for now in seen])


def along_path(
    vehicle: Vehicle, path: Path, reference: tuple[float, float], speed: float, *, plant: Motive | None = None
) -> list[Truth]:
    """What was seen every 20 ms while the driver put a point of the tractor, in T [m], on the path to its end.

    At grip, if no other plant is given.
    """
    tractor = vehicle.units[0]
    if tractor.steering is None:
        raise ValueError(f"vehicle {vehicle.name}: the tractor has no steering")
    driver = PreviewDriver(
        TractorGeometry(
            wheelbase=tractor.steered_axles[0].x,
            x_ref=reference[0],
            y_ref=reference[1],
            max_steer=tractor.steering.limit,
            max_steer_rate=tractor.steering.rate_limit,
            actuator_lag=tractor.steering.lag,
        ),
        path,
        speed,
    )
    perception, memory, plant = DriverPerception(), driver.init(), plant or Plant(vehicle, GRIP)
    start = path.start @ Pose2(*reference, 0.0).inverse()
    state, idle = plant.initial_state(start, speed), (0.0,) * _steered_behind(vehicle)
    seen: list[Truth] = []
    while memory.station < path.length - 1e-6:
        seen.append(plant.observe(state, len(seen) * _CONTROL))
        memory, demand = driver.step(memory, seen[-1].tick, perception.sample(seen[-1]))
        state = plant.step(state, VehicleCommand(demand.steer, demand.acceleration, idle), _CONTROL)
    return seen


def round_circle(
    vehicle: Vehicle,
    radius: float,
    speed: float,
    way: float,
    *,
    approach: float = 0.0,
    haste: float = 1.0,
    trailer_steer: tuple[float, ...] = (),
    surface: Surface = GRIP,
) -> list[Truth]:
    """What was seen every 0.1 s over ``way`` [m] on a left-hand circle of the tractor's rear axle.

    The tractor starts on the circle, the units behind it stretched along the hitch's direction of travel. The first
    ``approach`` [m] go ``haste`` times as fast, and are not told of.
    """
    plant = Plant(vehicle, surface)
    steer = math.atan(vehicle.units[0].steered_axles[0].x / radius)
    state = _on_circle(plant, vehicle, radius, haste * speed if approach else speed, steer)
    seen: list[Truth] = []
    gone = -approach
    while gone < way:
        now = plant.observe(state, len(seen) * _HELD)
        if gone >= 0.0:
            seen.append(now)
        v_x = now.velocities[0, 0]
        wanted = haste * speed if gone < -_SLOWING * haste * speed else speed
        state = plant.step(state, VehicleCommand(steer, _SPEED_GAIN * (wanted - v_x), trailer_steer), _HELD)
        gone += v_x * _HELD * TICK
    return seen


def steered(vehicle: Vehicle, demand: Callable[[float], float], speed: float, duration: float) -> list[Truth]:
    """What was seen every 20 ms under a steer demand [rad] over time [s], from straight running, at grip."""
    plant = Plant(vehicle, GRIP)
    state, idle = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), (0.0,) * _steered_behind(vehicle)
    seen: list[Truth] = []
    for tick in range(0, round(duration / TICK) + 1, _CONTROL):
        seen.append(plant.observe(state, tick))
        acceleration = _SPEED_GAIN * (speed - seen[-1].velocities[0, 0])
        state = plant.step(state, VehicleCommand(demand(tick * TICK), acceleration, idle), _CONTROL)
    return seen


def _steered_behind(vehicle: Vehicle) -> int:
    return sum(len(unit.steered_axles) for unit in vehicle.units[1:])


def _on_circle(plant: Plant, vehicle: Vehicle, radius: float, speed: float, steer: float) -> FloatArray:
    """The tractor turning with its rear axle on the circle; what it tows begins to turn."""
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
