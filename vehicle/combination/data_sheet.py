"""Data sheet of a combination: axle loads, smallest circles, handling figures, and warnings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from vehicle.combination import handling
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.plausibility import implausibilities
from vehicle.combination.unit import Axle, Unit

STANDARD_SPEED = 80.0 / 3.6  # [m/s] at which European heavy vehicles are limited and assessed
_SQUARE = math.radians(89.0)  # largest road-wheel angle: nearly square to the unit


@dataclass(frozen=True, slots=True, kw_only=True)
class AxleSheet:
    """One axle of the standing combination."""

    x: float  # in its unit [m]
    behind_front: float  # behind the foremost point of the straight combination [m]
    load: float  # on level ground [N]; 0 if lifted
    nominal_share: float  # wheel load over its tyre's nominal load [-]
    steered: bool
    driven: bool
    lifted: bool
    reach: float | None  # largest road-wheel angle at the axle's middle [rad]; None if it is not steered
    group: str | None  # axles of a unit in the same group turn together


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitSheet:
    """One unit of the standing combination."""

    name: str
    mass: float  # [kg]
    body_length: float  # [m]
    behind_front: float  # of its origin, behind the foremost point of the straight combination [m]
    coupling_load: float | None  # that its front hitch puts on the unit ahead [N]; None for the tractor
    smallest_circle: float | None  # [m], see tightest_turn and tightest_following; None without steered axles
    axles: tuple[AxleSheet, ...]  # lifted ones too, front to rear


@dataclass(frozen=True, slots=True, kw_only=True)
class Handling:
    """Handling figures at one speed."""

    speed: float  # [m/s]
    understeer_gradient: float  # [rad/(m/s2)], + understeer
    characteristic_speed: float | None  # [m/s]; None if it oversteers
    critical_speed: float | None  # [m/s]; None if straight running is stable at any road speed
    yaw_damping: float  # ratio of the least damped mode [-]
    rearward_amplification: float | None  # peak of the last unit's lateral acceleration over the first's [-]
    rollover_threshold: float  # static, lateral acceleration [m/s2]


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSheet:
    """Data sheet of a combination, without its handling."""

    name: str
    summary: str
    mass: float  # [kg]
    length: float  # [m]
    width: float  # [m]
    height: float  # [m]
    units: tuple[UnitSheet, ...]
    warnings: tuple[str, ...]  # inconsistencies between numbers, a line each

    @property
    def stands(self) -> bool:
        """True if every axle that is not lifted carries a load."""
        return all(axle.load > 0.0 or axle.lifted for unit in self.units for axle in unit.axles)


def data_sheet(vehicle: Vehicle) -> DataSheet:
    """Data sheet of a combination, without its handling."""
    loads, couplings = _axle_loads(vehicle), coupling_loads(vehicle)
    units = tuple(
        UnitSheet(
            name=unit.name,
            mass=unit.mass,
            body_length=unit.front_x - unit.rear_x,
            behind_front=vehicle.units[0].front_x - origin,
            coupling_load=couplings[i],
            smallest_circle=tightest_turn(unit) if i == 0 else tightest_following(unit),
            axles=_axles(unit, loads[i], vehicle.units[0].front_x - origin),
        )
        for i, (unit, origin) in enumerate(zip(vehicle.units, origins(vehicle), strict=True))
    )
    return DataSheet(
        name=vehicle.name,
        summary=vehicle.summary,
        mass=vehicle.mass,
        length=vehicle.length,
        width=max(unit.width for unit in vehicle.units),
        height=max(unit.height for unit in vehicle.units),
        units=units,
        warnings=implausibilities(vehicle, loads, couplings),
    )


@lru_cache(maxsize=32)
def handling_at(vehicle: Vehicle, speed: float = STANDARD_SPEED) -> Handling:
    """Handling figures at a ``speed`` [m/s].

    Raises:
        ValueError: if its drive cannot hold this speed.
    """
    amplifies = len(vehicle.units) > 1
    return Handling(
        speed=speed,
        understeer_gradient=handling.understeer_gradient(vehicle, speed),
        characteristic_speed=handling.characteristic_speed(vehicle, speed),
        critical_speed=handling.critical_speed(vehicle),
        yaw_damping=handling.yaw_damping(vehicle, speed),
        rearward_amplification=handling.peak_rearward_amplification(vehicle, speed).gain if amplifies else None,
        rollover_threshold=handling.static_rollover_threshold(vehicle),
    )


def origins(vehicle: Vehicle) -> tuple[float, ...]:
    """Positions of the units' origins in the tractor's frame, combination straight [m]."""
    positions = [0.0]
    for ahead in vehicle.units[:-1]:
        positions.append(positions[-1] + ahead.rear_hitch[0])
    return tuple(positions)


def coupling_loads(vehicle: Vehicle) -> tuple[float | None, ...]:
    """Load [N] that each unit's front hitch puts on the unit ahead, on level ground; None for the tractor."""
    loads: list[float | None] = []
    below = 0.0
    for unit, axles in zip(reversed(vehicle.units), reversed(_axle_loads(vehicle)), strict=True):
        below += unit.mass * GRAVITY - sum(axles)
        loads.append(below)
    return (None, *reversed(loads[:-1]))


def tightest_turn(unit: Unit) -> float | None:
    """Radius [m] swept by the outer front corner of a motor vehicle at full lock, without slip."""
    fixed = [axle.x for axle in unit.axles if not axle.steered]
    if not fixed or not unit.steered_axles:
        return None
    middle = sum(fixed) / len(fixed)
    radius = max(abs(axle.x - middle) / math.tan(reach(unit, axle)) for axle in unit.steered_axles)
    return math.hypot(radius + 0.5 * unit.width, unit.front_x - middle)


def tightest_following(unit: Unit) -> float | None:
    """Radius [m] of the smallest circle on which a towed unit's steered axles keep its follow point on the path.

    In that steady turn the unit's turning centre lies beside the middle between hitch and follow point, without slip.
    """
    if unit.follow_x is None or not unit.steered_axles:
        return None
    middle = 0.5 * unit.follow_x
    across = max(abs(axle.x - middle) / math.tan(reach(unit, axle)) for axle in unit.steered_axles)
    return math.hypot(across, middle)


def reach(unit: Unit, axle: Axle) -> float:
    """Largest road-wheel angle [rad] at a steered axle's middle."""
    largest = unit.steering.limit * abs(axle.steer_ratio) if unit.steering else 0.0
    return min(largest, _SQUARE)


def _axle_loads(vehicle: Vehicle) -> list[list[float]]:
    return [[float(load) for load in of_unit] for of_unit in static_axle_loads(vehicle)]


def _axles(unit: Unit, loads: Sequence[float], behind_front: float) -> tuple[AxleSheet, ...]:
    carried = dict(zip((axle.x for axle in unit.axles), loads, strict=True))
    return tuple(
        AxleSheet(
            x=axle.x,
            behind_front=behind_front - axle.x,
            load=carried.get(axle.x, 0.0),
            nominal_share=0.5 * carried.get(axle.x, 0.0) / axle.tyre.nominal_load,
            steered=axle.steered,
            driven=axle.driven,
            lifted=axle.lifted,
            reach=reach(unit, axle) if axle.steered else None,
            group=axle.steer_group,
        )
        for axle in sorted((*unit.axles, *unit.lifted_axles), key=lambda axle: -axle.x)
    )
