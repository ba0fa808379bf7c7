"""Handling figures of a combination from its linearised motion: steering, stability, amplification, rollover.

Tyres and bodies follow without delay unless ``tyre_dynamics`` is asked for, and speeds are constant.
"""

import math
from itertools import pairwise
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar

from vehicle.combination.description import Vehicle
from vehicle.combination.linear import LateralModel, lateral_model
from vehicle.combination.roll import static_rollover
from vehicle.frames import FloatArray

Amplified: TypeAlias = Literal["lateral_acceleration", "yaw_rate"]

_TOP_SPEED: Final = 70.0  # [m/s] 250 km/h, beyond any road vehicle with a trailer
_TURNING_SPEED: Final = 5.0  # [m/s] for figures that do not depend on speed
_SPEED_STEP: Final = 1.0  # [m/s] of the search for a critical speed; no instability begins and ends within it


class Amplification(NamedTuple):
    """A peak of rearward amplification."""

    gain: float  # [-]
    frequency: float  # [Hz]


def understeer_gradient(vehicle: Vehicle, speed: float) -> float:
    """Increase of the steer angle per lateral acceleration at constant radius [rad/(m/s2)], + understeer.

    With G the steady yaw rate over steer angle, steer angle times radius is V / G = L + K V^2: K is its slope over V^2.
    """
    slow, fast = 0.9 * speed, 1.1 * speed  # a straight line over V^2, so any span will do
    return (_angle_times_radius(vehicle, fast) - _angle_times_radius(vehicle, slow)) / (fast**2 - slow**2)


def characteristic_speed(vehicle: Vehicle, speed: float) -> float | None:
    """Speed [m/s] of the largest yaw-rate gain, from the gradient at ``speed`` [m/s]; None if it oversteers."""
    K = understeer_gradient(vehicle, speed)
    wheelbase = _angle_times_radius(vehicle, speed) - K * speed**2
    return math.sqrt(wheelbase / K) if K > 0.0 else None


def critical_speed(vehicle: Vehicle) -> float | None:
    """Lowest speed [m/s] at which straight running is unstable; None if it is stable up to 70 m/s."""
    speeds = np.arange(_SPEED_STEP, _TOP_SPEED + 0.5 * _SPEED_STEP, _SPEED_STEP).tolist()
    for slow, fast in pairwise(speeds):
        if _growth(fast, vehicle) > 0.0:
            return float(brentq(_growth, slow, fast, args=(vehicle,)))
    return None


def yaw_damping(vehicle: Vehicle, speed: float, *, tyre_dynamics: bool = False) -> float:
    """Damping ratio of the least damped yaw-plane mode [-]; 1 if none oscillates, negative if unstable.

    With ``tyre_dynamics`` tyres and bodies follow with their lags; those modes of the whole model count that lie
    nearest to the ones without.
    """
    modes = lateral_model(vehicle, speed).eigenvalues()
    if tyre_dynamics:
        lagged = lateral_model(vehicle, speed, tyre_dynamics=True).eigenvalues()
        modes = np.array([lagged[np.argmin(np.abs(lagged - mode))] for mode in modes])
    return float(np.min(-modes.real / np.abs(modes)))


def rearward_amplification(
    vehicle: Vehicle, speed: float, frequencies: ArrayLike, of: Amplified = "lateral_acceleration"
) -> FloatArray:
    """Amplitude at the last unit over that at the first [-], steered at ``frequencies`` [Hz], of their shape."""
    model = lateral_model(vehicle, speed, outputs=(of,))
    return _amplification(model, frequencies)


def peak_rearward_amplification(
    vehicle: Vehicle, speed: float, of: Amplified = "lateral_acceleration"
) -> Amplification:
    """Largest rearward amplification between 0.05 and 2 Hz, the range of drivers."""
    model = lateral_model(vehicle, speed, outputs=(of,))
    grid = np.geomspace(0.05, 2.0, 200)
    best = int(np.argmax(_amplification(model, grid)))
    bounds = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, len(grid) - 1)])
    peak = minimize_scalar(lambda f: -float(_amplification(model, f)), bounds=bounds, method="bounded")
    return Amplification(gain=-float(peak.fun), frequency=float(peak.x))


def static_rollover_threshold(vehicle: Vehicle) -> float:
    """Lateral acceleration [m/s2] in a steady turn beyond which the combination tips.

    If the suspensions are not given, the one at which a unit first stands on the wheels of one side only: then load
    transfer, body roll included, is proportional to lateral acceleration.

    Raises:
        ValueError: if the suspensions do not carry the bodies.
    """
    if vehicle.has_springs:
        return static_rollover(vehicle).threshold
    model = lateral_model(vehicle, _TURNING_SPEED, outputs=("lateral_acceleration", "load_transfer"))
    gains = [model.steady_gain(name) for name in model.outputs]
    a_y, transfer = np.split(np.array(gains), 2)
    return float(np.min(a_y / transfer))


def _amplification(model: LateralModel, frequencies: ArrayLike) -> FloatArray:
    first, last = model.outputs[0], model.outputs[-1]
    return np.abs(model.response(last, frequencies)) / np.abs(model.response(first, frequencies))


def _growth(speed: float, vehicle: Vehicle) -> float:
    """Growth rate of the least stable mode [1/s]."""
    return float(lateral_model(vehicle, speed).eigenvalues().real.max())


def _angle_times_radius(vehicle: Vehicle, speed: float) -> float:
    return speed / lateral_model(vehicle, speed, outputs=("yaw_rate",)).steady_gain("yaw_rate_0")
