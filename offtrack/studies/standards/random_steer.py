"""Pseudo-random steer: the frequency response of rearward amplification, compared with linear theory.

After the pseudo-random input of ISO 14791: steer that holds all frequencies from 0.1 to 1.5 Hz and repeats itself. The
first period lets the combination settle. In the second one input and output are periodic, so the ratio of their spectra
is the frequency response without leakage. The amplitude is small, 0.05 g at the front axle, so that
linear theory must agree.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from offtrack.studies.standards.proving_ground import (
    PERIOD,
    STANDARD,
    Conditions,
    Figures,
    Manoeuvre,
    drive_programme,
    measured,
)
from scenarios.results.log import Log
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.linear import lateral_model
from vehicle.frames import FloatArray

SPEED: Final = 88.0 / 3.6  # [m/s]
PEAK: Final = 0.05 * GRAVITY  # lateral acceleration of the front axle by linear theory [m/s2]
NAMES: Final = ("random_amplification", "random_amplification_frequency_hz", "random_theory_difference")

_FRICTION: Final = 0.8  # a dry road [-]
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
    speed, friction = conditions.speed_or(SPEED), conditions.friction_or(_FRICTION)
    angles = conditions.side * np.tile(steer_cycle(vehicle, speed, friction), 2)
    driven = drive_programme(vehicle, angles, speed=speed, friction=friction, trailer_steering=trailer_steering)

    def figures() -> Figures:
        response = amplification_response(vehicle, driven.log, speed, friction)
        best = int(np.argmax(response.measured))
        strong = response.measured >= _COMPARED * response.measured[best]
        ratio = response.measured[strong] / response.theory[strong]
        return {
            "random_amplification": float(response.measured[best]),
            "random_amplification_frequency_hz": float(response.frequency[best]),
            "random_theory_difference": math.nan if trailer_steering != "none" else float(np.max(np.abs(ratio - 1.0))),
        }

    return Manoeuvre(
        key="random_steer",
        title="Frequency response of rearward amplification",
        how=f"{3.6 * speed:g} km/h, pseudo-random steer from {_BAND[0]:g} to {_BAND[1]:g} Hz with peaks of 0.05 g at "
        f"the front axle, friction {friction:g}.",
        outcome=driven.outcome,
        figures=measured(NAMES, driven.outcome, figures),
        log=driven.log,
        conditions=conditions,
    )


def steer_cycle(vehicle: Vehicle, speed: float, friction: float) -> FloatArray:
    """One period of steer [rad], one value every ``PERIOD``."""
    f: FloatArray = np.fft.rfftfreq(_COUNT, PERIOD * TICK).astype(np.float64)
    excited = (f >= _BAND[0] - 1e-9) & (f <= _BAND[1] + 1e-9)
    phases = np.random.default_rng(_SEED).uniform(0.0, 2.0 * math.pi, len(f))
    spectrum = np.where(excited, np.exp(1j * phases), 0.0)
    front = np.zeros(len(f), dtype=np.complex128)
    front[excited] = _gains(vehicle, speed, friction, f[excited])[0] * spectrum[excited]
    steer: FloatArray = np.fft.irfft(spectrum, _COUNT) * (PEAK / np.max(np.abs(np.fft.irfft(front, _COUNT))))
    return steer


def amplification_response(vehicle: Vehicle, log: Log, speed: float, friction: float) -> Response:
    """Rearward amplification in the second period of the drive, and by linear theory."""
    first, last = vehicle.units[0], vehicle.units[-1]
    front, rear = (
        _acceleration_spectrum(log, unit.name, x) for unit, x in ((first, first.steered_axles[0].x), (last, last.cg_x))
    )
    f: FloatArray = np.fft.rfftfreq(_COUNT, PERIOD * TICK).astype(np.float64)
    lines = (f >= _BAND[0] - 1e-9) & (f <= _BAND[1] + 1e-9)
    of_front, of_rear = _gains(vehicle, speed, friction, f[lines])
    return Response(f[lines], np.abs(rear[lines] / front[lines]), np.abs(of_rear / of_front))


def theoretical_peak(vehicle: Vehicle, speed: float) -> float:
    """Largest rearward amplification in the band by linear theory with the lags of tyres and roll [-]."""
    front, rear = _gains(vehicle, speed, _FRICTION, np.linspace(*_BAND, round((_BAND[1] - _BAND[0]) * _CYCLE) + 1))
    return float(np.max(np.abs(rear / front)))


def response_of(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Response:
    """The frequency response of a finished drive."""
    conditions = manoeuvre.conditions
    return amplification_response(vehicle, manoeuvre.log, conditions.speed_or(SPEED), conditions.friction_or(_FRICTION))


def _acceleration_spectrum(log: Log, unit: str, x: float) -> NDArray[np.complex128]:
    """Spectrum of the lateral acceleration of a unit's point in the second period [m/s2]."""
    rows = slice(_COUNT, 2 * _COUNT)
    yaw_rate = log[f"yaw_rate_{unit}"][rows]
    lateral = np.fft.rfft(log[f"v_y_{unit}"][rows] + x * yaw_rate)
    rate = 2j * math.pi * np.fft.rfftfreq(_COUNT, PERIOD * TICK) * lateral
    spectrum: NDArray[np.complex128] = rate + np.fft.rfft(log[f"v_x_{unit}"][rows] * yaw_rate)
    return spectrum


def _gains(
    vehicle: Vehicle, speed: float, friction: float, frequencies: FloatArray
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Lateral acceleration of the front axle and of the last unit's centre of gravity over steer [m/s2/rad]."""
    model = lateral_model(
        vehicle,
        speed,
        friction=friction,
        outputs=("lateral_acceleration", "axle_position"),
        path=True,
        tyre_dynamics=True,
    )
    tractor = vehicle.units[0]
    axle = tractor.axles.index(tractor.steered_axles[0])
    s = 2j * math.pi * frequencies
    front = model.response(f"axle_position_{axle}", frequencies) * s**2
    return front, model.response(f"lateral_acceleration_{len(vehicle.units) - 1}", frequencies)
