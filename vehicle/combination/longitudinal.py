"""Longitudinal capability of a combination from its data: starting, climbing, acceleration, and holding downhill.

Straight, quasi-static: loads shift with grade and drive force, tyres roll without slip losses, and the driven tyres
transmit friction times their load at most. Needs the vehicle's table ``[powertrain]`` for forces in low gears.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

from scipy.optimize import brentq

from vehicle.combination.actuators import air_drag, retarder_capacity
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.loads import axle_loads
from vehicle.combination.multibody import Vector
from vehicle.combination.unit import Unit
from vehicle.tyres import Planar
from vehicle.tyres.tyre import Tyre

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
    return end if surplus(end) >= 0.0 else float(brentq(surplus, 0.0, end, xtol=1e-9))


def _loads(vehicle: Vehicle, normal: float, felt: float) -> list[list[float]]:
    """Axle loads [N] of the straight combination under a specific force along it [m/s2]."""
    n, rolling = len(vehicle.units), [0.0] * len(vehicle.units)
    loads: list[list[float]] = []
    for _ in range(2):  # rolling resistance depends little on the loads that it shifts
        pulls = [sum(unit.mass * felt + drag for unit, drag in _from(vehicle, rolling, i)) for i in range(n)]
        hitches = [Vector(0.0 if i == 0 else pull, 0.0) for i, pull in enumerate(pulls)]
        on_axles = axle_loads(vehicle, [normal] * n, [felt] * n, hitches, [Vector(1.0, 0.0)] * n)
        loads = [[float(load) for load in of_unit] for of_unit in on_axles]
        rolling = [_rolling(unit, of_unit) for unit, of_unit in zip(vehicle.units, loads, strict=True)]
    return loads


def _from(vehicle: Vehicle, rolling: Sequence[float], i: int) -> Iterator[tuple[Unit, float]]:
    return zip(vehicle.units[i:], rolling[i:], strict=True)


def _rolling(unit: Unit, loads: Sequence[float]) -> float:
    """Rolling resistance of a unit [N]."""
    return sum(axle.tyre.rolling_resistance * load for axle, load in zip(unit.axles, loads, strict=True))


def _limit(tyre: Tyre, load: float, friction: float) -> float:
    """Largest force over load of a tyre [-]."""
    return float(tyre.grip(load, friction, Planar(0.0, 0.0), 1.0).limit)
