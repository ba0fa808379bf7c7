"""The single lane change of ISO 14791 at 88 km/h: rearward amplification and transient off-tracking.

The standard prescribes the motion of the front axle: one period of sinusoidal lateral acceleration, 0.4 Hz and 0.15 g,
which moves it 1.464 m to the side. A steering robot drives it. A small steer pulse gives the frequency response H(f)
from steer to the front axle's lateral acceleration. The inverse of H gives the steer for the prescribed acceleration.
As the combination is not quite linear, a few passes remove the remaining error in the same way (iterative learning
control). The figures do not depend on a driver model.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from offtrack.studies.standards.proving_ground import (
    PERIOD,
    STANDARD,
    Conditions,
    Drive,
    Figures,
    Manoeuvre,
    SteerProgramme,
    amplification,
    drive,
    half_sine,
    lateral_acceleration,
    measured,
    overshoot,
    point_path,
)
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.frames import FloatArray
from vehicle.surface import Surface

SPEED: Final = 88.0 / 3.6  # [m/s]
FREQUENCY: Final = 0.4  # [Hz]
PEAK: Final = 0.15 * GRAVITY  # [m/s2]
OFFSET: Final = PEAK / (2.0 * math.pi * FREQUENCY**2)  # final lateral offset [m]

NAMES: Final = (
    "rearward_amplification",
    "rearward_amplification_yaw",
    "transient_off_tracking_m",
    "front_peak_acceleration_m_s2",
    "front_path_error_m",
    "lane_change_load_transfer",
)

FRICTION: Final = 0.8  # a dry road [-]
_START: Final = 2.0  # of the lane change [s]
_LENGTH: Final = 16.0  # of a pass [s]: oscillations decay in the last 11 s
_PULSE: Final = math.radians(0.5)  # steer pulse, for 0.2 s: well inside the linear range
_PASSES: Final = 3  # the error does not fall further
_TOLERANCE: Final = 0.15  # largest path error of a valid manoeuvre, a tenth of the offset [m]
_PASS, _STOP = 2.5, 4.0  # pass band and stop band of the robot's steer [Hz]


def lane_change(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Lane change, by default to the left, as driven in the robot's last pass.

    If the robot can not keep the combination on the path, for instance an unstable one, the outcome is "off the path".
    """
    driven = _learnt(vehicle, trailer_steering, conditions)
    front = point_path(driven.log, vehicle.units[0].name, _front(vehicle))
    prescribed = prescribed_path(front[:, 0] - _front(vehicle), conditions)
    off_path = driven.outcome == "completed" and float(np.max(np.abs(front[:, 1] - prescribed))) > _TOLERANCE
    outcome = "off the path" if off_path else driven.outcome
    return Manoeuvre(
        key="lane_change",
        title="Single lane change of ISO 14791",
        how=f"{3.6 * conditions.speed_or(SPEED):g} km/h, one period of 0.4 Hz and 0.15 g at the front axle, "
        f"{OFFSET:.3f} m to the {conditions.hand}, friction {conditions.friction_or(FRICTION):g}; "
        "a steering robot learns the steer in three passes.",
        outcome=outcome,
        figures=measured(NAMES, outcome, lambda: _figures(vehicle, driven, conditions)),
        log=driven.log,
        course=np.column_stack([front[:, 0], prescribed]),
    )


def prescribed_acceleration(time: FloatArray) -> FloatArray:
    """Prescribed lateral acceleration of the front axle [m/s2] at times since the start of a pass [s]."""
    phase = 2.0 * math.pi * FREQUENCY * (time - _START)
    wave: FloatArray = np.where((phase > 0.0) & (phase < 2.0 * math.pi), PEAK * np.sin(phase), 0.0)
    return wave


def prescribed_path(distance: FloatArray, conditions: Conditions = STANDARD) -> FloatArray:
    """Prescribed lateral position of the front axle [m] at distances from the start of a pass [m]."""
    time = distance / conditions.speed_or(SPEED)
    phase = np.clip(2.0 * math.pi * FREQUENCY * (time - _START), 0.0, 2.0 * math.pi)
    lateral: FloatArray = conditions.side * OFFSET * (phase - np.sin(phase)) / (2.0 * math.pi)
    return lateral


def _learnt(vehicle: Vehicle, trailer_steering: str, conditions: Conditions) -> Drive:
    """Last pass of the robot, or the first that ends in a mishap."""
    count = round(_LENGTH / (PERIOD * TICK))
    pulse = half_sine(_PULSE, 0.2, _START, count, PERIOD)
    driven = _pass(vehicle, trailer_steering, pulse, conditions)
    if driven.outcome != "completed":
        return driven
    inverse = _inverse_response(pulse, lateral_acceleration(driven.log, vehicle.units[0].name, _front(vehicle))[:count])
    side = conditions.side
    steer, error = np.zeros(count), side * prescribed_acceleration(driven.log["time"][:count])
    for _ in range(1 + _PASSES):
        steer = steer + np.fft.irfft(inverse * np.fft.rfft(error), count)
        driven = _pass(vehicle, trailer_steering, steer, conditions)
        if driven.outcome != "completed":
            break
        achieved = lateral_acceleration(driven.log, vehicle.units[0].name, _front(vehicle))
        error = (side * prescribed_acceleration(driven.log["time"]) - achieved)[:count]
    return driven


def _pass(vehicle: Vehicle, trailer_steering: str, steer: FloatArray, conditions: Conditions) -> Drive:
    last, speed = len(steer) * PERIOD, conditions.speed_or(SPEED)  # [ticks], [m/s]
    return drive(
        vehicle,
        Surface(friction=conditions.friction_or(FRICTION)),
        SteerProgramme(steer, speed, PERIOD),
        trailer_steering=trailer_steering,
        speed=speed,
        done=lambda truth: truth.tick >= last,
        patience=2.0 * _LENGTH,
    )


def _inverse_response(steer: FloatArray, acceleration: FloatArray) -> NDArray[np.complex128]:
    """Steer per front-axle acceleration at the frequencies of ``rfft``, faded out above the pass band."""
    f = np.fft.rfftfreq(len(steer), PERIOD * TICK)
    fade = 0.5 + 0.5 * np.cos(math.pi * np.clip((f - _PASS) / (_STOP - _PASS), 0.0, 1.0))
    response = np.fft.rfft(steer)[f < _STOP] / np.fft.rfft(acceleration)[f < _STOP]
    inverse = np.zeros(len(f), dtype=np.complex128)
    inverse[f < _STOP] = fade[f < _STOP] * response
    return inverse


def _front(vehicle: Vehicle) -> float:
    return vehicle.units[0].steered_axles[0].x


def _figures(vehicle: Vehicle, driven: Drive, conditions: Conditions) -> Figures:
    log, first, last = driven.log, vehicle.units[0], vehicle.units[-1]
    front = lateral_acceleration(log, first.name, _front(vehicle))
    rear = lateral_acceleration(log, last.name, last.cg_x)
    steered = point_path(log, first.name, _front(vehicle))
    followed = point_path(log, last.name, last.axles[-1].x)
    error = steered[:, 1] - prescribed_path(steered[:, 0] - _front(vehicle), conditions)
    as_left = (1.0, conditions.side)
    return {
        "rearward_amplification": amplification(rear, front),
        "rearward_amplification_yaw": amplification(log[f"yaw_rate_{last.name}"], log[f"yaw_rate_{first.name}"]),
        "transient_off_tracking_m": overshoot(followed * as_left, steered * as_left),
        "front_peak_acceleration_m_s2": float(np.max(np.abs(front))),
        "front_path_error_m": float(np.max(np.abs(error))),
        "lane_change_load_transfer": max(float(np.max(np.abs(log[f"load_transfer_{u.name}"]))) for u in vehicle.units),
    }
