"""Yaw stability: sine with dwell, and the damping after a steer pulse.

0.5 Hz with 1 s of dwell after three quarters of the period, from 72 km/h: as NHTSA proposed for truck tractors in 2012
(NHTSA-2012-0065, from memory; the final rule has another test). A stable combination stops yawing soon after.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np

from offtrack.studies.standards.proving_ground import (
    PERIOD,
    STANDARD,
    Conditions,
    Drive,
    Figures,
    Manoeuvre,
    amplification,
    articulation,
    damping,
    drive_programme,
    half_sine,
    lateral_acceleration,
    measured,
)
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.linear import lateral_model
from vehicle.frames import FloatArray

DWELL_SPEED: Final = 72.0 / 3.6  # [m/s]
FREQUENCY: Final = 0.5  # [Hz]
DWELL: Final = 1.0  # [s]
STEADY: Final = 0.2 * GRAVITY  # lateral acceleration that the amplitude would cause if it were held [m/s2]
START: Final = 1.0  # [s]
END: Final = START + 1.0 / FREQUENCY + DWELL  # of steering [s]
DWELL_NAMES: Final = (
    "dwell_steer_deg",
    "dwell_peak_acceleration_m_s2",
    "dwell_amplification_yaw",
    "dwell_yaw_rate_ratio_0_75_s",
    "dwell_yaw_rate_ratio_1_5_s",
    "dwell_displacement_m",
    "dwell_load_transfer",
)

_DWELL_FRICTION: Final = 0.8  # a dry road [-]
_DWELL_LENGTH: Final = 10.0  # of the test [s]


def sine_with_dwell(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Sine with dwell at the road wheels, by default first to the left."""
    speed, friction = conditions.speed_or(DWELL_SPEED), conditions.friction_or(_DWELL_FRICTION)
    amplitude = steer_for(vehicle, STEADY, speed)
    count = round(_DWELL_LENGTH / (PERIOD * TICK))
    time: FloatArray = PERIOD * TICK * np.arange(count, dtype=np.float64)
    angles = conditions.side * amplitude * wave(time)
    driven = drive_programme(vehicle, angles, speed=speed, friction=friction, trailer_steering=trailer_steering)
    return Manoeuvre(
        key="sine_with_dwell",
        title="Sine with dwell",
        how=f"{3.6 * speed:g} km/h, {math.degrees(amplitude):.2f}° at the road wheels first to the {conditions.hand}, "
        f"{FREQUENCY:g} Hz with {DWELL:g} s of dwell, friction {friction:g}. Held, that angle would cause 0.2 g by "
        "linear theory.",
        outcome=driven.outcome,
        figures=measured(DWELL_NAMES, driven.outcome, lambda: _dwell_figures(vehicle, driven, amplitude)),
        log=driven.log,
    )


def steer_for(vehicle: Vehicle, acceleration: float, speed: float) -> float:
    """Road-wheel angle [rad] of a steady lateral acceleration [m/s2] by linear theory."""
    gain = lateral_model(vehicle, speed, outputs=("yaw_rate",)).steady_gain("yaw_rate_0")
    return acceleration / (abs(gain) * speed)


def wave(time: FloatArray) -> FloatArray:
    """Sine with dwell of amplitude 1 at times [s]: three quarters of a period, the dwell, the last quarter."""
    turned, held = 0.75 / FREQUENCY, 0.75 / FREQUENCY + DWELL
    t = time - START
    phase = np.where(t < turned, t, np.where(t < held, turned, t - DWELL))
    values: FloatArray = np.where((t > 0.0) & (time < END), np.sin(2.0 * math.pi * FREQUENCY * phase), 0.0)
    return values


def _dwell_figures(vehicle: Vehicle, driven: Drive, amplitude: float) -> Figures:
    log, first, last = driven.log, vehicle.units[0], vehicle.units[-1]
    time = log["time"]
    yaw = {unit.name: np.abs(log[f"yaw_rate_{unit.name}"]) for unit in vehicle.units}

    def left(after: float) -> float:
        """Largest yaw rate of any unit from that time after the steering on, over that unit's peak [-]."""
        later = time >= END + after
        return max(float(rate[later].max() / rate.max()) for rate in yaw.values())

    lateral = np.abs(log[f"y_{first.name}"] - log[f"y_{first.name}"][0])
    return {
        "dwell_steer_deg": math.degrees(amplitude),
        "dwell_peak_acceleration_m_s2": max(
            float(np.max(np.abs(lateral_acceleration(log, unit.name, unit.cg_x)))) for unit in vehicle.units
        ),
        "dwell_amplification_yaw": amplification(yaw[last.name], yaw[first.name]),
        "dwell_yaw_rate_ratio_0_75_s": left(0.75),
        "dwell_yaw_rate_ratio_1_5_s": left(1.5),
        "dwell_displacement_m": float(np.interp(END, time, lateral)),
        "dwell_load_transfer": max(float(np.max(np.abs(log[f"load_transfer_{u.name}"]))) for u in vehicle.units),
    }


SPEED: Final = 80.0 / 3.6  # [m/s]
NAMES: Final = ("yaw_damping", "pulse_load_transfer")

_FRICTION: Final = 0.8  # a dry road [-]
_PULSE_STEER: Final = math.radians(2.0)  # peak of the pulse: about 0.1 g, in the linear range of tyres
_PULSE_DURATION: Final = 0.3  # of the pulse [s]: short compared with a trailer's period of 2 to 4 s
_PULSE_START: Final = 0.5  # [s]
_PULSE_LENGTH: Final = 12.0  # of the test [s]


def pulse(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Steer pulse, by default to the left, then steering held straight."""
    count = round(_PULSE_LENGTH / (PERIOD * TICK))
    speed, friction = conditions.speed_or(SPEED), conditions.friction_or(_FRICTION)
    angles = half_sine(conditions.side * _PULSE_STEER, _PULSE_DURATION, _PULSE_START, count, PERIOD)
    driven = drive_programme(vehicle, angles, speed=speed, friction=friction, trailer_steering=trailer_steering)
    return Manoeuvre(
        key="pulse",
        title="Yaw damping after a steer pulse",
        how=f"{3.6 * speed:g} km/h, half a sine of 2° and 0.3 s to the {conditions.hand} at the road wheels, steering "
        f"held straight afterwards, friction {friction:g}.",
        outcome=driven.outcome,
        figures=measured(NAMES, driven.outcome, lambda: _pulse_figures(vehicle, driven)),
        log=driven.log,
    )


def _pulse_figures(vehicle: Vehicle, driven: Drive) -> Figures:
    """Damping of the least damped yaw rate or articulation angle, and load transfer."""
    log, names = driven.log, [unit.name for unit in vehicle.units]
    free = log["time"] > _PULSE_START + _PULSE_DURATION
    motions = [log[f"yaw_rate_{name}"] for name in names]
    motions += [articulation(log, *pair) for pair in pairwise(names)]
    return {
        "yaw_damping": min(damping(motion[free]) for motion in motions),
        "pulse_load_transfer": max(float(np.max(np.abs(log[f"load_transfer_{name}"]))) for name in names),
    }
