"""Linear closed loop of a combination and its preview driver on a straight road.

The combination is `lateral_model` with its tyres, roll and actuators over one period of the driver; the driver is the
code of runs, linearised by differences. So nothing of the driver's own model enters on the combination's side.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg import expm

from controllers.driver import PERIOD, DriverMemory, PreviewDriver
from controllers.path import Path, line
from controllers.preview_law import Motion
from scenarios.assembly.tractor_data import tractor_guided_at
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.linear import ComplexArray, lateral_model
from vehicle.frames import FloatArray, Pose2

_REMEMBERED: Final = ("demand", "steer", "front_slip", "rear_slip", "side", "turn")  # besides v_y and yaw rate
_SEEN: Final = 4  # y, psi, v_y, yaw rate
_STEP: Final = 1e-6  # of the differences: rounding and curvature both cost 1e-9
_STATION: Final = 50.0  # anywhere on the straight [m]
_AT_REST: Final = 1e-9  # eigenvalues of a memory that only stores what was seen


def driver_modes(vehicle: Vehicle, driven: Vehicle, speed: float, ahead: float) -> ComplexArray:
    """Eigenvalues [1/s] of the closed loop at ``speed`` [m/s].

    Args:
        vehicle: as the driver's data sheet has it.
        driven: the combination that is driven.
        speed: [m/s].
        ahead: guided point on the tractor's axis, in T [m].
    """
    model = lateral_model(
        driven, speed, outputs=("lateral_velocity", "yaw_rate"), tyre_dynamics=True, actuators=True, path=True
    )
    n = len(model.A)
    held = np.zeros((n + 1, n + 1))
    held[:n] = np.column_stack([model.A, model.B[:, 0]])
    over_period = expm(PERIOD * held)[:n]
    seen = np.zeros((_SEEN, n))
    seen[0, model.states.index("y")] = seen[1, model.states.index("psi")] = 1.0
    for row, output in ((2, "lateral_velocity_0"), (3, "yaw_rate_0")):
        seen[row] = model.C[model.outputs.index(output)]
    driver = _driver(vehicle, speed, ahead)
    m = len(driver)
    by_memory, by_state = driver[:, :m], driver[:, m:] @ seen
    loop = np.zeros((n + m, n + m))
    loop[:n, :n] = over_period[:, :n] + np.outer(over_period[:, n], by_state[0])
    loop[:n, n:] = np.outer(over_period[:, n], by_memory[0])
    loop[n:, :n], loop[n:, n:] = by_state, by_memory
    multipliers = np.linalg.eigvals(loop)
    moving = multipliers[np.abs(multipliers) > _AT_REST].astype(np.complex128)
    return np.asarray(np.log(moving), dtype=np.complex128) / PERIOD


def _driver(vehicle: Vehicle, speed: float, ahead: float) -> FloatArray:
    """New memory of the driver by old memory and what is seen, (m, m + 4); the first is the steer demand."""
    driver = PreviewDriver(
        tractor_guided_at(vehicle, (ahead, 0.0)), Path(Pose2(0.0, 0.0, 0.0), (line(10.0 * _STATION),)), speed
    )
    tick, m = round(PERIOD / TICK), len(_REMEMBERED) + 2

    def step(values: list[float]) -> FloatArray:
        *remembered, v_y_before, yaw_rate_before, y, psi, v_y, yaw_rate = values
        demand, steer, front, rear, side, turn = remembered
        before = Motion(speed, v_y_before, yaw_rate_before)
        memory = DriverMemory(0, _STATION, demand, steer, front, 0.0, rear, side, turn, before)
        x = _STATION + speed * PERIOD - ahead * math.cos(psi)
        seen = EgoState(tick=tick, x=x, y=y, psi=psi, v_x=speed, v_y=v_y, yaw_rate=yaw_rate)
        after, _ = driver.step(memory, tick, seen)
        return np.array([*(getattr(after, name) for name in _REMEMBERED), after.motion.v_y, after.motion.yaw_rate])

    steps = (_STEP * np.eye(m + _SEEN)).tolist()
    opposite = (-_STEP * np.eye(m + _SEEN)).tolist()
    return np.column_stack([(step(a) - step(b)) / (2.0 * _STEP) for a, b in zip(steps, opposite, strict=True)])
