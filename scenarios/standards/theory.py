"""Figures of the standard manoeuvres by linear theory, for comparison with the measured ones."""

from __future__ import annotations

import math

import numpy as np

from scenarios.standards import lane_change, pulse, random_steer
from scenarios.standards.manoeuvre import Figures
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.handling import static_rollover_threshold, understeer_gradient, yaw_damping
from vehicle.combination.lateral_outputs import OutputKind
from vehicle.combination.linear import ComplexArray, lateral_model
from vehicle.frames import FloatArray

_LENGTH = 41.0  # of the periodic lane change [s]: all motion decays in the last 37 s
_STEP = 0.01  # [s]
_CIRCLE_SPEED = 8.0  # on the steady circle of 100 m, at 0.065 g [m/s]


def linear_figures(vehicle: Vehicle, *, speed: float | None = None, tyre_dynamics: bool = True) -> Figures:
    """Figures by linear theory, with the names of the measured ones; without those that do not apply.

    Without ``speed`` [m/s] the manoeuvres have their own. Without ``tyre_dynamics`` tyres, roll and hitch forces follow
    without lag.
    """
    return {
        "yaw_damping": yaw_damping(vehicle, speed or pulse.SPEED, tyre_dynamics=tyre_dynamics),
        "rollover_threshold_g": static_rollover_threshold(vehicle) / GRAVITY,
        "understeer_gradient_deg_per_g": math.degrees(understeer_gradient(vehicle, _CIRCLE_SPEED)) * GRAVITY,
        "random_amplification": random_steer.theoretical_peak(vehicle, speed or random_steer.SPEED),
        **(
            _lane_change(vehicle, speed or lane_change.SPEED, tyre_dynamics=tyre_dynamics)
            if len(vehicle.units) > 1
            else {}
        ),
    }


def _lane_change(vehicle: Vehicle, speed: float, *, tyre_dynamics: bool) -> Figures:
    """Lane change with the front axle exactly on its path.

    Ratios of frequency responses give all motions from the front axle's; the steer cancels. The last axle is farthest
    out when the front axle is already on the straight line, so its later arrival does not matter.
    """
    count = round(_LENGTH / _STEP)
    time: FloatArray = _STEP * np.arange(count, dtype=np.float64)
    f = np.fft.rfftfreq(count, _STEP)[1:]  # 0 Hz is omitted: the mean of one sine period is 0
    s = 2j * math.pi * f
    kinds: tuple[OutputKind, ...] = ("lateral_acceleration", "yaw_rate", "axle_position")
    model = lateral_model(vehicle, speed, outputs=kinds, path=True, tyre_dynamics=tyre_dynamics)
    response = {name: model.response(name, f) for name in model.outputs}
    last, axle = len(vehicle.units) - 1, sum(len(unit.axles) for unit in vehicle.units) - 1
    front = response["axle_position_0"] * s**2
    prescribed = np.fft.rfft(lane_change.prescribed_acceleration(time))[1:]

    def motion(ratio: ComplexArray) -> FloatArray:
        values: FloatArray = np.fft.irfft(np.concatenate([[0.0], prescribed * ratio]), count)
        return values

    yaw = [motion(response[f"yaw_rate_{unit}"] / front) for unit in (0, last)]
    offset = motion((response[f"axle_position_{axle}"] - response["axle_position_0"]) / front)
    return {
        "rearward_amplification": _peak(motion(response[f"lateral_acceleration_{last}"] / front)) / lane_change.PEAK,
        "rearward_amplification_yaw": _peak(yaw[1]) / _peak(yaw[0]),
        "transient_off_tracking_m": float(np.max(offset) - offset[0]),  # before the change there is no offset
    }


def _peak(values: FloatArray) -> float:
    return float(np.max(np.abs(values)))
