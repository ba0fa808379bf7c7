"""Figures of a combination: handling from its linearised motion, and longitudinal capability from its data.

Tyres and bodies follow without delay, and speeds are constant.

Straight, quasi-static: loads shift with grade and drive force, tyres roll without slip losses, and the driven tyres
transmit friction times their load at most. Needs the vehicle's table ``[powertrain]`` for forces in low gears.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from vehicle.combination.actuators import air_drag, retarder_capacity
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.linear import LateralModel, lateral_model
from vehicle.combination.loads import chain_loads
from vehicle.combination.multibody import Vector
from vehicle.combination.roll import static_rollover
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray
from vehicle.tyres import Planar
from vehicle.tyres.tyre import Tyre

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
            return float(scipy.optimize.brentq(_growth, slow, fast, args=(vehicle,)))
    return None


def yaw_damping(vehicle: Vehicle, speed: float) -> float:
    """Damping ratio of the least damped yaw-plane mode [-]; 1 if none oscillates, negative if unstable."""
    modes = lateral_model(vehicle, speed).eigenvalues()
    return float(np.min(-modes.real / np.abs(modes)))


def rearward_amplification(vehicle: Vehicle, speed: float, frequencies: ArrayLike) -> FloatArray:
    """Lateral acceleration of the last unit over the first's [-], steered at ``frequencies`` [Hz], of their shape."""
    return _amplification(lateral_model(vehicle, speed, outputs=("lateral_acceleration",)), frequencies)


def peak_rearward_amplification(vehicle: Vehicle, speed: float) -> Amplification:
    """Largest rearward amplification between 0.05 and 2 Hz, the range of drivers."""
    model = lateral_model(vehicle, speed, outputs=("lateral_acceleration",))
    grid = np.geomspace(0.05, 2.0, 200)
    best = int(np.argmax(_amplification(model, grid)))
    bounds = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, len(grid) - 1)])
    peak = scipy.optimize.minimize_scalar(lambda f: -float(_amplification(model, f)), bounds=bounds, method="bounded")
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


DRY: Final = 0.8  # friction of a dry road [-]
_STEEPEST: Final = 1.0  # grade of the search [-]
_FASTEST: Final = 70.0  # speed of the search [m/s]
_STEP: Final = 0.01  # of the acceleration run [s]; its error is far below the model's


class Capability(NamedTuple):
    """Longitudinal capability on dry road."""

    startability: float  # steepest grade on which it moves off [-]
    gradeability: float  # steepest grade on which it keeps 10 km/h [-]
    speed_on_1_percent_kmh: float  # largest steady speed on a grade of 1 %
    acceleration_100_m_s: float  # from rest over 100 m of level road, without shifts of gear
    holding_grade: float | None  # steepest downhill grade, positive, on which the endurance brake keeps 30 km/h [-]


class Balance(NamedTuple):
    """Forces on a combination on a grade, straight ahead."""

    driven_load: float  # on all driven axles [N]
    driving: float  # largest driving force [N], by engine, friction and demand
    resisting: float  # weight along the road, rolling and air [N]


def engine_force(vehicle: Vehicle, speed: float) -> float:
    """Largest driving force [N] at the treads at a speed [m/s], without limits of friction."""
    force = vehicle.mass * vehicle.drive.max_acceleration
    if vehicle.powertrain is not None:
        force = min(force, vehicle.powertrain.launch_force)
    return min(force, vehicle.drive.max_power / max(speed, 1e-3))


def balance(vehicle: Vehicle, grade: float, speed: float, *, friction: float = DRY, gain: float = 0.0) -> Balance:
    """Balance on a grade [-], + uphill, at a speed [m/s] while the speed rises at ``gain`` [m/s2]."""
    slope = math.atan(grade)
    normal, along = GRAVITY * math.cos(slope), GRAVITY * math.sin(slope)
    felt = gain + along  # specific force along the road
    loads = _loads(vehicle, normal, felt)
    air = float(air_drag(vehicle.air, speed))
    rolling = sum(_rolling(unit, of_unit) for unit, of_unit in zip(vehicle.units, loads, strict=True))
    driven = [(axle, load) for axle, load in zip(vehicle.units[0].axles, loads[0], strict=True) if axle.driven]
    grip = sum(load * _limit(axle.tyre, 0.5 * load, friction) for axle, load in driven)
    return Balance(
        driven_load=sum(load for _, load in driven),
        driving=min(engine_force(vehicle, speed), grip),
        resisting=vehicle.mass * along + rolling + air,
    )


def longitudinal_capability(vehicle: Vehicle) -> Capability:
    """All figures on dry road."""
    slow, downhill = 10.0 / 3.6, 30.0 / 3.6
    return Capability(
        startability=startability(vehicle),
        gradeability=gradeability(vehicle, slow),
        speed_on_1_percent_kmh=3.6 * climbing_speed(vehicle, 0.01),
        acceleration_100_m_s=acceleration_time(vehicle, 100.0),
        holding_grade=holding_grade(vehicle, downhill) if float(retarder_capacity(vehicle, downhill)) > 0.0 else None,
    )


def startability(vehicle: Vehicle, friction: float = DRY) -> float:
    """Steepest grade [-] on which it moves off."""
    return _largest(lambda grade: _surplus(balance(vehicle, grade, 0.0, friction=friction)), _STEEPEST)


def gradeability(vehicle: Vehicle, speed: float, friction: float = DRY) -> float:
    """Steepest grade [-] on which it keeps a speed [m/s]."""
    return _largest(lambda grade: _surplus(balance(vehicle, grade, speed, friction=friction)), _STEEPEST)


def climbing_speed(vehicle: Vehicle, grade: float, friction: float = DRY) -> float:
    """Largest steady speed [m/s] on a grade [-], up to the governor's; 0 if it does not climb it."""
    fastest = _FASTEST
    if vehicle.powertrain is not None:
        fastest = min(fastest, vehicle.powertrain.top_speed - vehicle.powertrain.governor_band)
    return _largest(lambda speed: _surplus(balance(vehicle, grade, speed, friction=friction)), fastest)


def acceleration_time(vehicle: Vehicle, distance: float, friction: float = DRY) -> float:
    """Time [s] from rest over a distance [m] on level road at full throttle, behind the driveline's lag."""
    effective = vehicle.mass + rotating_mass(vehicle)
    station = speed = force = time = 0.0
    while station < distance:
        now = balance(vehicle, 0.0, speed, friction=friction, gain=max(force, 0.0) / vehicle.mass)
        force = min(
            vehicle.mass * vehicle.drive.max_acceleration * (1.0 - math.exp(-time / vehicle.drive.lag)), now.driving
        )
        gain = (force - now.resisting) / effective
        speed = max(speed + gain * _STEP, 0.0)
        station, time = station + speed * _STEP, time + _STEP
        if time > 600.0:
            return math.inf
    return time


def holding_grade(vehicle: Vehicle, speed: float, friction: float = DRY) -> float:
    """Steepest downhill grade [-], a positive number, that the endurance brake holds at a speed [m/s]."""

    def surplus(grade: float) -> float:
        now = balance(vehicle, -grade, speed, friction=friction)
        grip = friction * now.driven_load
        return min(float(retarder_capacity(vehicle, speed)), grip) + now.resisting

    return _largest(surplus, _STEEPEST)


def rotating_mass(vehicle: Vehicle) -> float:
    """Inertia of all wheels as a mass at the treads [kg]."""
    return sum(wheel.axle.wheel_inertia / wheel.axle.wheel_radius**2 for wheel in wheels(vehicle))


def _surplus(now: Balance) -> float:
    return now.driving - now.resisting


def _largest(surplus: Callable[[float], float], end: float) -> float:
    """Largest argument up to ``end`` at which the surplus, which falls, is not negative; 0 if there is none."""
    if surplus(0.0) <= 0.0:
        return 0.0
    return end if surplus(end) >= 0.0 else float(scipy.optimize.brentq(surplus, 0.0, end, xtol=1e-9))


def _loads(vehicle: Vehicle, normal: float, felt: float) -> list[list[float]]:
    """Axle loads [N] of the straight combination under a specific force along it [m/s2]."""
    n, rolling = len(vehicle.units), [0.0] * len(vehicle.units)
    loads: list[list[float]] = []
    for _ in range(2):  # rolling resistance depends little on the loads that it shifts
        needed = [unit.mass * felt + drag for unit, drag in zip(vehicle.units, rolling, strict=True)]
        pulls = [sum(needed[i:]) for i in range(n)]
        hitches = [Vector(0.0 if i == 0 else pull, 0.0) for i, pull in enumerate(pulls)]
        on_axles = chain_loads(vehicle, [normal] * n, [felt] * n, hitches, [Vector(1.0, 0.0)] * n).axles
        loads = [[float(load) for load in of_unit] for of_unit in on_axles]
        rolling = [_rolling(unit, of_unit) for unit, of_unit in zip(vehicle.units, loads, strict=True)]
    return loads


def _rolling(unit: Unit, loads: Sequence[float]) -> float:
    """Rolling resistance of a unit [N]."""
    return sum(axle.tyre.rolling_resistance * load for axle, load in zip(unit.axles, loads, strict=True))


def _limit(tyre: Tyre, load: float, friction: float) -> float:
    """Largest force over load of a tyre [-]."""
    return float(tyre.grip(load, friction, Planar(0.0, 0.0), 1.0).limit)
