"""Trailers, truths, readings and estimates that tests share."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from controllers.trailer import Combination, TrailerGeometry
from estimators.estimates import Health, OffTracking
from sensors.messages import CombinationSignals
from vehicle.combination.description import load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

TWO_OF_THREE: Final = TrailerGeometry(
    follow_distance=14.0,
    axle_distances=(8.0, 9.31, 10.62),
    steered=(False, True, True),
    max_steer=math.radians(30.0),
    max_steer_rate=math.radians(20.0),
    actuator_lag=0.15,
)
ALL_STEERED: Final = replace(TWO_OF_THREE, steered=(True, True, True))
COMBINATION: Final = Combination(load_vehicle("uk_longer_semitrailer"), 1)


def signals(tick: int, **changes: Any) -> CombinationSignals:
    """Readings of a combination with two steered trailer axles, straight and at rest but for the changes."""
    at_rest = CombinationSignals(
        tick=tick,
        angles=np.zeros(2),
        speed=0.0,
        steer=0.0,
        articulation=np.zeros(1),
        yaw_rates=np.zeros(2),
        lateral_acceleration=0.0,
    )
    return replace(at_rest, **changes)


def estimate(tick: int, **changes: Any) -> OffTracking:
    """Straight travel at 2.8 m/s, 16 m of the path straight behind the hitch, but for the changes."""
    straight = OffTracking(
        tick=tick,
        value=0.0,
        std=0.01,
        health=Health.OK,
        path=np.column_stack([-np.linspace(0.0, 16.0, 60), np.zeros(60)]),
        hitch_direction=0.0,
        hitch_direction_rate=0.0,
        path_tangent=0.0,
        v_x=2.8,
        v_y=0.0,
        yaw_rate=0.0,
    )
    return replace(straight, **changes)


def steps(
    law: Any,
    until: int,
    seen: Callable[[int], OffTracking | None],
    memory: Any = None,
    start: int = 0,
    speed: float = 0.0,
) -> tuple[Any, FloatArray]:
    """Memory of a law after steps every 20 ms, and its commands (n, axles), with immediate actuators.

    ``seen(tick)`` is the newest estimate that has arrived by then.
    """
    memory = law.init() if memory is None else memory
    angles, commands = np.array(memory.demand), []
    for tick in range(start, until, 20):
        memory, command = law.step(memory, tick, seen(tick), signals(tick, angles=angles, speed=speed))
        angles = command.angles
        commands.append(angles)
    return memory, np.array(commands)


def truth(tick: int, *, bodies: FloatArray, **changes: Any) -> Truth:
    """Truth of units with these poses of their bodies (N, 4, 4): at rest at the origin, but for the changes."""
    n, nothing = len(bodies), np.empty(0)
    still = Truth(
        tick=tick,
        poses=np.zeros((n, 3)),
        velocities=np.zeros((n, 3)),
        bodies=bodies,
        steer=nothing,
        wheel_loads=nothing,
        wheel_slip_angles=nothing,
        friction_used=nothing,
        load_transfer=np.zeros(n),
    )
    return replace(still, **changes)
