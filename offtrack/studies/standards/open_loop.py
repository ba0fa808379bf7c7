"""Manoeuvres of a steering robot: single lane change, steer pulse, sine with dwell, and pseudo-random steer.

Lane change of ISO 14791: the standard prescribes the motion of the front axle, one period of sinusoidal lateral
acceleration, 0.4 Hz and 0.15 g, which moves it 1.464 m to the side. A small steer pulse gives the frequency response
H(f) from steer to the front axle's lateral acceleration; the inverse of H gives the steer for the prescribed
acceleration. As the combination is not quite linear, a few passes remove the remaining error in the same way (iterative
learning control). The figures do not depend on a driver model.

Sine with dwell: 0.5 Hz with 1 s of dwell after three quarters of the period, from 72 km/h, as NHTSA proposed for truck
tractors in 2012 (NHTSA-2012-0065, from memory; the final rule has another test). A stable combination stops yawing soon
after.

Pseudo-random steer, after that of ISO 14791, holds all frequencies from 0.1 to 1.5 Hz and repeats itself. The first
period lets the combination settle. In the second one input and output are periodic, so the ratio of their spectra is
the frequency response without leakage. The amplitude is small, 0.05 g at the front axle, so that linear theory must
agree.
"""

import dataclasses
import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from offtrack.studies.standards.proving_ground import (
    KINDS,
    PERIOD,
    STANDARD,
    Conditions,
    Drive,
    Figures,
    Manoeuvre,
    Setting,
    amplification,
    articulation,
    axle_paths,
    damping,
    drive_programme,
    half_sine,
    largest_load_transfer,
    lateral_acceleration,
    overshoot,
    point_path,
    result,
)
from scenarios.results.log import Log
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.linear import ComplexArray, OutputKind, lateral_model
from vehicle.frames import FloatArray

CHANGE_FREQUENCY: Final = 0.4  # [Hz]
CHANGE_PEAK: Final = 0.15 * GRAVITY  # [m/s2]
CHANGE_OFFSET: Final = CHANGE_PEAK / (2.0 * math.pi * CHANGE_FREQUENCY**2)  # final lateral offset [m]
_CHANGE_START: Final = 2.0  # of the lane change [s]
_CHANGE_LENGTH: Final = 16.0  # of a pass [s]: oscillations decay in the last 11 s
_PROBE: Final = math.radians(0.5)  # steer pulse, for 0.2 s: well inside the linear range
_PASSES: Final = 3  # the error does not fall further
_TOLERANCE: Final = 0.15  # largest path error of a valid manoeuvre, a tenth of the offset [m]
_PASS, _STOP = 2.5, 4.0  # pass band and stop band of the robot's steer [Hz]


def lane_change(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Lane change, by default to the left, as driven in the robot's last pass.

    If the robot can not keep the combination on the path, for instance an unstable one, the outcome is "off the path".
    """
    at = KINDS["lane_change"].under(conditions)
    driven = _learnt(vehicle, trailer_steering, at)
    front = point_path(driven.log, vehicle.units[0].name, _front(vehicle))
    prescribed = prescribed_path(front[:, 0] - _front(vehicle), at)
    if driven.outcome == "completed" and float(np.max(np.abs(front[:, 1] - prescribed))) > _TOLERANCE:
        driven = dataclasses.replace(driven, outcome="off the path")
    return result(
        "lane_change",
        f"{3.6 * at.speed:g} km/h, one period of 0.4 Hz and 0.15 g at the front axle, {CHANGE_OFFSET:.3f} m to the "
        f"{at.hand}, friction {at.friction:g}; a steering robot learns the steer in three passes.",
        driven,
        lambda: _change_figures(vehicle, driven.log, at),
        course=np.column_stack([front[:, 0], prescribed]),
    )


def prescribed_acceleration(time: FloatArray) -> FloatArray:
    """Prescribed lateral acceleration of the front axle [m/s2] at times since the start of a pass [s]."""
    phase = 2.0 * math.pi * CHANGE_FREQUENCY * (time - _CHANGE_START)
    wave: FloatArray = np.where((phase > 0.0) & (phase < 2.0 * math.pi), CHANGE_PEAK * np.sin(phase), 0.0)
    return wave


def prescribed_path(distance: FloatArray, at: Setting) -> FloatArray:
    """Prescribed lateral position of the front axle [m] at distances from the start of a pass [m]."""
    phase = np.clip(2.0 * math.pi * CHANGE_FREQUENCY * (distance / at.speed - _CHANGE_START), 0.0, 2.0 * math.pi)
    lateral: FloatArray = at.side * CHANGE_OFFSET * (phase - np.sin(phase)) / (2.0 * math.pi)
    return lateral


def _learnt(vehicle: Vehicle, trailer_steering: str, at: Setting) -> Drive:
    """Last pass of the robot, or the first that ends in a mishap."""
    count = round(_CHANGE_LENGTH / (PERIOD * TICK))
    pulse = half_sine(_PROBE, 0.2, _CHANGE_START, count, PERIOD)

    def passed(steer: FloatArray) -> tuple[Drive, FloatArray]:
        """The drive, and the lateral acceleration of the front axle [m/s2]."""
        driven = drive_programme(vehicle, at.surface, steer, speed=at.speed, trailer_steering=trailer_steering)
        return driven, lateral_acceleration(driven.log, vehicle.units[0].name, _front(vehicle))[:count]

    driven, achieved = passed(pulse)
    if driven.outcome != "completed":
        return driven
    inverse = _inverse_response(pulse, achieved)
    steer, demanded = np.zeros(count), at.side * prescribed_acceleration(driven.log["time"][:count])
    error = demanded
    for _ in range(1 + _PASSES):
        steer = steer + np.fft.irfft(inverse * np.fft.rfft(error), count)
        driven, achieved = passed(steer)
        if driven.outcome != "completed":
            break
        error = demanded - achieved
    return driven


def _inverse_response(steer: FloatArray, acceleration: FloatArray) -> ComplexArray:
    """Steer per front-axle acceleration at the frequencies of ``rfft``, faded out above the pass band."""
    f = np.fft.rfftfreq(len(steer), PERIOD * TICK)
    fade = 0.5 + 0.5 * np.cos(math.pi * np.clip((f - _PASS) / (_STOP - _PASS), 0.0, 1.0))
    response = np.fft.rfft(steer)[f < _STOP] / np.fft.rfft(acceleration)[f < _STOP]
    inverse = np.zeros(len(f), dtype=np.complex128)
    inverse[f < _STOP] = fade[f < _STOP] * response
    return inverse


def _front(vehicle: Vehicle) -> float:
    return vehicle.units[0].steered_axles[0].x


def _change_figures(vehicle: Vehicle, log: Log, at: Setting) -> Figures:
    first, last = vehicle.units[0], vehicle.units[-1]
    front = lateral_acceleration(log, first.name, _front(vehicle))
    steered, followed = axle_paths(vehicle, log)
    error = steered[:, 1] - prescribed_path(steered[:, 0] - _front(vehicle), at)
    as_left = (1.0, at.side)
    return {
        "rearward_amplification": amplification(lateral_acceleration(log, last.name, last.cg_x), front),
        "rearward_amplification_yaw": amplification(log[f"yaw_rate_{last.name}"], log[f"yaw_rate_{first.name}"]),
        "transient_off_tracking_m": overshoot(followed * as_left, steered * as_left),
        "front_peak_acceleration_m_s2": float(np.max(np.abs(front))),
        "front_path_error_m": float(np.max(np.abs(error))),
        "lane_change_load_transfer": largest_load_transfer(vehicle, log),
    }


_PULSE_STEER: Final = math.radians(2.0)  # peak of the pulse: about 0.1 g, in the linear range of tyres
_PULSE_DURATION: Final = 0.3  # of the pulse [s]: short compared with a trailer's period of 2 to 4 s
_PULSE_START: Final = 0.5  # [s]
_PULSE_LENGTH: Final = 12.0  # of the test [s]


def pulse(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Steer pulse, by default to the left, then steering held straight."""
    at, count = KINDS["pulse"].under(conditions), round(_PULSE_LENGTH / (PERIOD * TICK))
    angles = half_sine(at.side * _PULSE_STEER, _PULSE_DURATION, _PULSE_START, count, PERIOD)
    driven = drive_programme(vehicle, at.surface, angles, speed=at.speed, trailer_steering=trailer_steering)
    return result(
        "pulse",
        f"{3.6 * at.speed:g} km/h, half a sine of 2° and 0.3 s to the {at.hand} at the road wheels, steering held "
        f"straight afterwards, friction {at.friction:g}.",
        driven,
        lambda: _pulse_figures(vehicle, driven.log),
    )


def linear_pulse_damping(vehicle: Vehicle, speed: float, *, tyre_dynamics: bool = True) -> float:
    """Damping of the pulse's free motion by linear theory, read off it by the same rule as the measured one [-]."""
    step, count = PERIOD * TICK, round(4.0 * _PULSE_LENGTH / (PERIOD * TICK))  # periodic; no motion lasts that long
    time, f = step * np.arange(count), np.fft.rfftfreq(count, step)
    kinds: tuple[OutputKind, ...] = ("yaw_rate", "articulation")
    model = lateral_model(vehicle, speed, outputs=kinds, tyre_dynamics=tyre_dynamics, actuators=True)
    steer = np.fft.rfft(half_sine(_PULSE_STEER, _PULSE_DURATION, _PULSE_START, count, PERIOD))
    free = (time > _PULSE_START + _PULSE_DURATION) & (time <= _PULSE_LENGTH)
    motions = [np.fft.irfft(model.response(name, f) * steer, count)[free] for name in model.outputs]
    return min(damping(motion) for motion in motions)


def _pulse_figures(vehicle: Vehicle, log: Log) -> Figures:
    """Damping of the least damped yaw rate or articulation angle, and load transfer."""
    names, free = [unit.name for unit in vehicle.units], log["time"] > _PULSE_START + _PULSE_DURATION
    motions = [log[f"yaw_rate_{name}"] for name in names] + [articulation(log, *pair) for pair in pairwise(names)]
    return {
        "yaw_damping": min(damping(motion[free]) for motion in motions),
        "pulse_load_transfer": largest_load_transfer(vehicle, log),
    }


DWELL_FREQUENCY: Final = 0.5  # [Hz]
DWELL: Final = 1.0  # [s]
DWELL_START: Final = 1.0  # [s]
DWELL_END: Final = DWELL_START + 1.0 / DWELL_FREQUENCY + DWELL  # of steering [s]
_DWELL_STEADY: Final = 0.2 * GRAVITY  # lateral acceleration that the amplitude would cause if it were held [m/s2]
_DWELL_LENGTH: Final = 10.0  # of the test [s]


def sine_with_dwell(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Sine with dwell at the road wheels, by default first to the left."""
    at = KINDS["sine_with_dwell"].under(conditions)
    amplitude = steer_for(vehicle, _DWELL_STEADY, at.speed)
    time: FloatArray = PERIOD * TICK * np.arange(round(_DWELL_LENGTH / (PERIOD * TICK)), dtype=np.float64)
    angles = at.side * amplitude * sine_dwell_wave(time)
    driven = drive_programme(vehicle, at.surface, angles, speed=at.speed, trailer_steering=trailer_steering)
    return result(
        "sine_with_dwell",
        f"{3.6 * at.speed:g} km/h, {math.degrees(amplitude):.2f}° at the road wheels first to the {at.hand}, "
        f"{DWELL_FREQUENCY:g} Hz with {DWELL:g} s of dwell, friction {at.friction:g}. Held, that angle would cause "
        "0.2 g by linear theory.",
        driven,
        lambda: _dwell_figures(vehicle, driven.log, amplitude),
    )


def steer_for(vehicle: Vehicle, acceleration: float, speed: float) -> float:
    """Road-wheel angle [rad] of a steady lateral acceleration [m/s2] by linear theory."""
    gain = lateral_model(vehicle, speed, outputs=("yaw_rate",)).steady_gain("yaw_rate_0")
    return acceleration / (abs(gain) * speed)


def sine_dwell_wave(time: FloatArray) -> FloatArray:
    """Sine with dwell of amplitude 1 at times [s]: three quarters of a period, the dwell, the last quarter."""
    turned, held = 0.75 / DWELL_FREQUENCY, 0.75 / DWELL_FREQUENCY + DWELL
    t = time - DWELL_START
    phase = np.where(t < turned, t, np.where(t < held, turned, t - DWELL))
    values: FloatArray = np.where((t > 0.0) & (time < DWELL_END), np.sin(2.0 * math.pi * DWELL_FREQUENCY * phase), 0.0)
    return values


def _dwell_figures(vehicle: Vehicle, log: Log, amplitude: float) -> Figures:
    first, last, time = vehicle.units[0], vehicle.units[-1], log["time"]
    yaw = {unit.name: np.abs(log[f"yaw_rate_{unit.name}"]) for unit in vehicle.units}
    accelerations = (np.abs(lateral_acceleration(log, unit.name, unit.cg_x)) for unit in vehicle.units)

    def left(after: float) -> float:
        """Largest yaw rate of any unit from that time after the steering on, over that unit's peak [-]."""
        later = time >= DWELL_END + after
        return max(float(rate[later].max() / rate.max()) for rate in yaw.values())

    lateral = np.abs(log[f"y_{first.name}"] - log[f"y_{first.name}"][0])
    return {
        "dwell_steer_deg": math.degrees(amplitude),
        "dwell_peak_acceleration_m_s2": max(float(values.max()) for values in accelerations),
        "dwell_amplification_yaw": amplification(yaw[last.name], yaw[first.name]),
        "dwell_yaw_rate_ratio_0_75_s": left(0.75),
        "dwell_yaw_rate_ratio_1_5_s": left(1.5),
        "dwell_displacement_m": float(np.interp(DWELL_END, time, lateral)),
        "dwell_load_transfer": largest_load_transfer(vehicle, log),
    }


RANDOM_PEAK: Final = 0.05 * GRAVITY  # lateral acceleration of the front axle by linear theory [m/s2]
_BAND: Final = (0.1, 1.5)  # [Hz]
_CYCLE: Final = 40.0  # period of the input [s]: lines every 0.025 Hz
_COUNT: Final = round(_CYCLE / (PERIOD * TICK))
_SEED: Final = 1  # of the phases, the same for every combination
_COMPARED: Final = 0.5  # smallest gain that is compared with theory, over the largest


class Response(NamedTuple):
    """Rearward amplification over frequency."""

    frequency: FloatArray  # (n,) [Hz]
    measured: FloatArray  # (n,) last unit's centre of gravity over the front axle [-]
    theory: FloatArray  # (n,) by linear theory with the lags of tyres and roll [-]


def random_steer(vehicle: Vehicle, trailer_steering: str, conditions: Conditions = STANDARD) -> Manoeuvre:
    """Two periods of pseudo-random steer."""
    at = KINDS["random_steer"].under(conditions)
    angles = at.side * np.tile(steer_cycle(vehicle, at.speed, at.friction), 2)
    driven = drive_programme(vehicle, at.surface, angles, speed=at.speed, trailer_steering=trailer_steering)

    def figures() -> Figures:
        response = amplification_response(vehicle, driven.log, at.speed, at.friction)
        best = int(np.argmax(response.measured))
        strong = response.measured >= _COMPARED * response.measured[best]
        ratio = response.measured[strong] / response.theory[strong]
        return {
            "random_amplification": float(response.measured[best]),
            "random_amplification_frequency_hz": float(response.frequency[best]),
            "random_theory_difference": math.nan if trailer_steering != "none" else float(np.max(np.abs(ratio - 1.0))),
        }

    return result(
        "random_steer",
        f"{3.6 * at.speed:g} km/h, pseudo-random steer from {_BAND[0]:g} to {_BAND[1]:g} Hz with peaks of 0.05 g at "
        f"the front axle, friction {at.friction:g}.",
        driven,
        figures,
        conditions=conditions,
    )


def steer_cycle(vehicle: Vehicle, speed: float, friction: float) -> FloatArray:
    """One period of steer [rad], one value every ``PERIOD``."""
    f, excited = _lines()
    phases = np.random.default_rng(_SEED).uniform(0.0, 2.0 * math.pi, len(f))
    spectrum = np.where(excited, np.exp(1j * phases), 0.0)
    front = np.zeros(len(f), dtype=np.complex128)
    front[excited] = _gains(vehicle, speed, friction, f[excited])[0] * spectrum[excited]
    steer: FloatArray = np.fft.irfft(spectrum, _COUNT) * (RANDOM_PEAK / np.max(np.abs(np.fft.irfft(front, _COUNT))))
    return steer


def _lines() -> tuple[FloatArray, NDArray[np.bool_]]:
    """Frequencies of ``rfft`` over a period [Hz], and which of them are excited."""
    f: FloatArray = np.fft.rfftfreq(_COUNT, PERIOD * TICK).astype(np.float64)
    return f, (f >= _BAND[0] - 1e-9) & (f <= _BAND[1] + 1e-9)


def amplification_response(vehicle: Vehicle, log: Log, speed: float, friction: float) -> Response:
    """Rearward amplification in the second period of the drive, and by linear theory."""
    last, (f, lines) = vehicle.units[-1], _lines()
    front = _acceleration_spectrum(log, vehicle.units[0].name, _front(vehicle))
    rear = _acceleration_spectrum(log, last.name, last.cg_x)
    of_front, of_rear = _gains(vehicle, speed, friction, f[lines])
    return Response(f[lines], np.abs(rear[lines] / front[lines]), np.abs(of_rear / of_front))


def theoretical_peak(vehicle: Vehicle, speed: float) -> float:
    """Largest rearward amplification in the band by linear theory with the lags of tyres and roll [-]."""
    f = np.linspace(*_BAND, round((_BAND[1] - _BAND[0]) * _CYCLE) + 1)
    front, rear = _gains(vehicle, speed, KINDS["random_steer"].friction, f)
    return float(np.max(np.abs(rear / front)))


def response_of(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Response:
    """The frequency response of a finished drive."""
    at = KINDS["random_steer"].under(manoeuvre.conditions)
    return amplification_response(vehicle, manoeuvre.log, at.speed, at.friction)


def _acceleration_spectrum(log: Log, unit: str, x: float) -> ComplexArray:
    """Spectrum of the lateral acceleration of a unit's point in the second period [m/s2]."""
    rows = slice(_COUNT, 2 * _COUNT)
    yaw_rate = log[f"yaw_rate_{unit}"][rows]
    lateral = np.fft.rfft(log[f"v_y_{unit}"][rows] + x * yaw_rate)
    rate = 2j * math.pi * np.fft.rfftfreq(_COUNT, PERIOD * TICK) * lateral
    spectrum: ComplexArray = rate + np.fft.rfft(log[f"v_x_{unit}"][rows] * yaw_rate)
    return spectrum


def _gains(
    vehicle: Vehicle, speed: float, friction: float, frequencies: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Lateral acceleration of the front axle and of the last unit's centre of gravity over steer [m/s2/rad]."""
    kinds: tuple[OutputKind, ...] = ("lateral_acceleration", "axle_position")
    model = lateral_model(vehicle, speed, friction=friction, outputs=kinds, path=True, tyre_dynamics=True)
    tractor = vehicle.units[0]
    axle = tractor.axles.index(tractor.steered_axles[0])
    front = model.response(f"axle_position_{axle}", frequencies) * (2j * math.pi * frequencies) ** 2
    return front, model.response(f"lateral_acceleration_{len(vehicle.units) - 1}", frequencies)
