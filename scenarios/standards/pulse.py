"""Yaw damping after a steer pulse at 80 km/h."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np

from scenarios.standards.conditions import STANDARD, Conditions
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.motion import articulation, damping
from scenarios.standards.pilots import half_sine
from scenarios.standards.proving_ground import PERIOD, Drive, drive_programme
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle

SPEED: Final = 80.0 / 3.6  # [m/s]
NAMES: Final = ("yaw_damping", "pulse_load_transfer")

_FRICTION: Final = 0.8  # a dry road [-]
_STEER: Final = math.radians(2.0)  # peak of the pulse: about 0.1 g, in the linear range of tyres
_DURATION: Final = 0.3  # of the pulse [s]: short compared with a trailer's period of 2 to 4 s
_START: Final = 0.5  # [s]
_LENGTH: Final = 12.0  # of the test [s]


def pulse(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Steer pulse, by default to the left, then steering held straight."""
    count = round(_LENGTH / (PERIOD * TICK))
    speed, friction = conditions.speed_or(SPEED), conditions.friction_or(_FRICTION)
    angles = half_sine(conditions.side * _STEER, _DURATION, _START, count, PERIOD)
    driven = drive_programme(vehicle, angles, speed=speed, friction=friction, trailer_steering=trailer_steering)
    return Manoeuvre(
        key="pulse",
        title="Yaw damping after a steer pulse",
        how=f"{3.6 * speed:g} km/h, half a sine of 2° and 0.3 s to the {conditions.hand} at the road wheels, steering "
        f"held straight afterwards, friction {friction:g}.",
        outcome=driven.outcome,
        figures=measured(NAMES, driven.outcome, lambda: _figures(vehicle, driven)),
        log=driven.log,
    )


def _figures(vehicle: Vehicle, driven: Drive) -> Figures:
    """Damping of the least damped yaw rate or articulation angle, and load transfer."""
    log, names = driven.log, [unit.name for unit in vehicle.units]
    free = log["time"] > _START + _DURATION
    motions = [log[f"yaw_rate_{name}"] for name in names]
    motions += [articulation(log, *pair) for pair in pairwise(names)]
    return {
        "yaw_damping": min(damping(motion[free]) for motion in motions),
        "pulse_load_transfer": max(float(np.max(np.abs(log[f"load_transfer_{name}"]))) for name in names),
    }
