"""Steady circle of constant radius with slowly rising speed: understeer, off-tracking and load transfer.

After the constant-radius test of ISO 14792. A steering robot keeps the curvature of the rear axle's path, and lateral
acceleration rises so slowly that all motion is steady. On a constant radius the slope of the steer angle over lateral
acceleration is the understeer gradient.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from controllers.driver import DriverCommand
from offtrack.studies.standards.proving_ground import (
    PERIOD,
    STANDARD,
    Conditions,
    Drive,
    Figures,
    Manoeuvre,
    SpeedHold,
    drive,
    lateral_acceleration,
    measured,
)
from scenarios.results.log import Log
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray
from vehicle.surface import Surface

RADIUS: Final = 100.0  # of the rear axle's path [m]
HIGHEST: Final = (
    0.25 * GRAVITY
)  # lateral acceleration at the end [m/s2]: below the rollover threshold of laden vehicles
AT: Final = 0.2 * GRAVITY  # at which off-tracking and load transfer are measured [m/s2]
NAMES: Final = (
    "understeer_gradient_deg_per_g",
    "understeer_gradient_at_0_2_g_deg_per_g",
    "circle_steer_deg",
    "circle_off_tracking_m",
    "circle_load_transfer",
)

_FRICTION: Final = 0.8  # a dry road [-]
_LOWEST: Final = 0.02 * GRAVITY  # lateral acceleration at the start [m/s2]
_SETTLING: Final = 20.0  # at the start [s]: 90 m, several lengths
_RAMP: Final = 60.0  # of rising acceleration [s]: 0.004 g a second
_LINEAR: Final = (0.04 * GRAVITY, 0.1 * GRAVITY)  # range of the understeer gradient [m/s2]
_AROUND: Final = 0.02 * GRAVITY  # of the gradient at 0.2 g to either side [m/s2]
_GAIN: Final = 2.0  # of the curvature's integral control [1/s]: slow beside tyres and yaw


class _Memory(NamedTuple):
    """State of the robot."""

    held: float  # acceleration that holds the speed [m/s2]
    steer: float  # [rad]


class _CircleRobot:
    """Keeps a curvature while lateral acceleration rises steadily."""

    def __init__(self, tractor: Unit, curvature: float) -> None:
        """Drive the ``curvature`` [1/m], + left, with this tractor."""
        self._wheelbase, self._curvature = tractor.steered_axles[0].x, curvature

    def init(self) -> _Memory:
        """Memory before the first step."""
        return _Memory(0.0, math.atan(self._wheelbase * self._curvature))

    def step(self, memory: _Memory, tick: int, ego: EgoState) -> tuple[_Memory, DriverCommand]:
        """New memory and command at ``tick``."""
        speed = set_speed(tick * TICK, 1.0 / abs(self._curvature))
        held, acceleration = SpeedHold.step(memory.held, speed - ego.v_x, PERIOD * TICK)
        error = self._curvature - ego.yaw_rate / max(ego.v_x, 1.0)
        steer = memory.steer + _GAIN * self._wheelbase * error * PERIOD * TICK
        return _Memory(held, steer), DriverCommand(steer=steer, acceleration=acceleration)


def set_speed(time: float, radius: float) -> float:
    """Speed [m/s] at a time [s] from the start."""
    share = min(max((time - _SETTLING) / _RAMP, 0.0), 1.0)
    return math.sqrt((_LOWEST + share * (HIGHEST - _LOWEST)) * radius)


def steady_circle(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Circle of constant radius, driven faster and faster up to 0.25 g."""
    radius, friction = conditions.radius_or(RADIUS), conditions.friction_or(_FRICTION)
    driven = drive(
        vehicle,
        Surface(friction=friction),
        _CircleRobot(vehicle.units[0], conditions.side / radius),
        trailer_steering=trailer_steering,
        speed=set_speed(0.0, radius),
        done=lambda truth: truth.tick * TICK >= _SETTLING + _RAMP,
        patience=2.0 * (_SETTLING + _RAMP),
    )
    reached = float(np.max(steer_over_acceleration(vehicle, driven.log)[0], initial=0.0))
    short = driven.outcome == "completed" and reached < AT + _AROUND  # of power, or of friction
    outcome = f"did not reach {(AT + _AROUND) / GRAVITY:.2f} g" if short else driven.outcome
    return Manoeuvre(
        key="steady_circle",
        title="Steady circle",
        how=f"Circle of {radius:g} m to the {conditions.hand}, lateral acceleration rising from 0.02 to 0.25 g in "
        f"{_RAMP:g} s, friction {friction:g}; constant-radius test after ISO 14792.",
        outcome=outcome,
        figures=measured(NAMES, outcome, lambda: _figures(vehicle, driven, conditions)),
        log=driven.log,
    )


def steer_over_acceleration(vehicle: Vehicle, log: Log) -> tuple[FloatArray, FloatArray]:
    """Lateral acceleration of the tractor [m/s2] and its steer angle [rad] over time, + into the turn."""
    tractor, settled = vehicle.units[0], log["time"] > _SETTLING
    acceleration = lateral_acceleration(log, tractor.name, tractor.cg_x)[settled]
    side = np.sign(acceleration[-1]) if len(acceleration) else 1.0
    return side * acceleration, side * log["steer_tractor"][settled]


def _figures(vehicle: Vehicle, driven: Drive, conditions: Conditions) -> Figures:
    log, side = driven.log, conditions.side
    acceleration, steer = steer_over_acceleration(vehicle, log)
    row = len(log) - len(acceleration) + int(np.argmin(np.abs(acceleration - AT)))
    first, last = vehicle.units[0], vehicle.units[-1]

    def slope(low: float, high: float) -> float:
        within = (acceleration >= low) & (acceleration <= high)
        return math.degrees(float(np.polyfit(acceleration[within], steer[within], 1)[0])) * GRAVITY

    def radius(unit: Unit, x: float) -> float:
        """Radius of the path of a point on a unit's axis at 0.2 g [m]."""
        v_x, v_y, r = (float(log[f"{name}_{unit.name}"][row]) for name in ("v_x", "v_y", "yaw_rate"))
        return math.hypot(v_x, v_y + x * r) / abs(r)

    inward = radius(first, first.steered_axles[0].x) - radius(last, last.axles[-1].x)
    transfers = [abs(float(log[f"load_transfer_{unit.name}"][row])) for unit in vehicle.units]
    return {
        "understeer_gradient_deg_per_g": slope(*_LINEAR),
        "understeer_gradient_at_0_2_g_deg_per_g": slope(AT - _AROUND, AT + _AROUND),
        "circle_steer_deg": math.degrees(float(side * log["steer_tractor"][row])),
        "circle_off_tracking_m": inward,
        "circle_load_transfer": max(transfers),
    }
