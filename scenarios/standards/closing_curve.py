"""Rollover from a slow ramp of the steer angle, as in ISO 11026: a closing curve at constant speed."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from scenarios.results.log import Log, Signal
from scenarios.standards.conditions import STANDARD, Conditions
from scenarios.standards.manoeuvre import Figures, Manoeuvre, measured
from scenarios.standards.proving_ground import drive_log
from scenarios.standards.ramp import Ramp, Tipping, driven
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.linear import lateral_model
from vehicle.surface import Surface

SPEED: Final = 60.0 / 3.6  # [m/s]
NAMES: Final = ("curve_rollover_g", "curve_rollover_roll_rad", "curve_rollover_steer_rad")

_JERK: Final = 0.2  # [m/s3] of the lateral acceleration at first: it follows without lag, within 1 % of the threshold
_FRICTION: Final = 0.8  # a dry road [-]
_LARGEST: Final = math.radians(30.0)  # steer angle [rad]


def closing_curve(vehicle: Vehicle, trailer_steering: str = "none", conditions: Conditions = STANDARD) -> Manoeuvre:
    """Steer slowly further into a curve at constant speed until the combination falls."""
    speed, friction = conditions.speed_or(SPEED), conditions.friction_or(_FRICTION)
    model = lateral_model(vehicle, speed, outputs=("lateral_acceleration",))
    gain = abs(model.steady_gain("lateral_acceleration_0"))
    ramp = Ramp(
        surface=lambda _: Surface(friction=friction),
        steer=lambda angle: conditions.side * angle,
        slope=lambda _: 0.0,
        speed=speed,
        rate=_JERK / gain,
        highest=_LARGEST,
    )
    tipping = driven(vehicle, ramp)
    demand = Signal("steer_demand", "rad", "demanded road-wheel angle, + left")
    log = drive_log(vehicle, tipping.truths).with_columns([(demand, conditions.side * tipping.levels)])
    return Manoeuvre(
        key="closing_curve",
        title="Rollover in a closing curve",
        how=f"{3.6 * speed:g} km/h and friction {friction:g}; the steer angle grows slowly, at first by {_JERK:g} m/s³ "
        "of lateral acceleration, until the combination falls. The threshold is the lateral acceleration at the "
        "largest steer angle that it holds, the mean of its units by mass.",
        outcome=tipping.outcome,
        figures=measured(NAMES, tipping.outcome, lambda: _figures(vehicle, tipping, log)),
        log=log,
    )


def _figures(vehicle: Vehicle, tipping: Tipping, log: Log) -> Figures:
    truth = tipping.steady
    masses = np.array([unit.mass for unit in vehicle.units])
    # In a steady turn the acceleration of each centre of gravity towards the turning centre, along the unit's y axis.
    accelerations = truth.velocities[:, 0] * truth.velocities[:, 2]
    rolls = np.arctan2(truth.bodies[:, 2, 1], truth.bodies[:, 2, 2])
    return {
        "curve_rollover_g": float(abs(masses @ accelerations) / masses.sum() / GRAVITY),
        "curve_rollover_roll_rad": float(np.abs(rolls).max()),
        "curve_rollover_steer_rad": float(tipping.levels[tipping.held]),
    }
