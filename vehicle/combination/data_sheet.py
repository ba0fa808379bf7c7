"""Data sheet of a combination: axle loads, smallest circles, handling figures, and implausible numbers.

Every number by itself is within its limits. The vehicle can be simulated, but its figures are probably not what its
author wanted.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final, NamedTuple

from vehicle.combination import handling
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.unit import Axle, Unit

_BEHIND_HITCH: Final = 1.5  # of the frame behind a fifth wheel or coupling [m]: a B-double's lead trailer has 1.4 m
_FOLLOW_MARGIN: Final = 1.0  # of a follow point behind the rear end [m]
_LARGEST_AXLE_LOAD: Final = 16e3 * GRAVITY  # four tyres of 4 t, load index 156: more than any road axle carries [N]
_CLOSE: Final = 1.9  # largest distance between neighbours of an axle group [m]; 96/53/EC counts up to 1.8 m
_EQUAL: Final = 0.9  # smallest over largest load of a group that shares equally [-]: brackets and friction take 10 %
_TOO_UNEQUAL: Final = 0.5  # smallest over largest declared ``load_share`` [-]: tag axles carry 0.55 and more
_GYRATION: Final = (0.1, 0.45)  # of a unit over its length [-]: coils in the middle have 0.14, a bar 0.29, two ends 0.5
_PITCH_GYRATION: Final = (0.05, 0.5)  # the same in pitch: springs are estimated less well
_ROLL_GYRATION: Final = 0.15  # smallest in roll, over the width [-]: a solid bar has 0.29
_WHEEL: Final = (80.0, 4800.0)  # mass of a wheel over its radius cubed [kg/m3]: 100 kg at 0.5 m is 800
_BRAKE: Final = (0.2, 5.0)  # brake force over axle load [-]: laden 0.5 to 1.2, unladen up to four times of it
_RIM: Final = 0.7  # radius of gyration of a wheel over its radius [-]


class _Extent(NamedTuple):
    """Reach of a unit's body, frame and drawbar along its x axis [m]."""

    rear: float
    front: float

    def holds(self, x: float) -> bool:
        """True if a position lies within the unit."""
        return self.rear <= x <= self.front

    def __str__(self) -> str:
        return f"{self.rear:g} m to {self.front:g} m"


def implausibilities(
    vehicle: Vehicle, loads: Sequence[Sequence[float]], couplings: Sequence[float | None]
) -> tuple[str, ...]:
    """A line for each relation that contradicts; empty for a plausible combination.

    ``loads`` [N] are those of the axles on the ground, ``couplings`` [N] those of each unit's front hitch on the unit
    ahead, standing on level ground.
    """
    of_units = (
        f"{place}: {line}"
        for i, unit in enumerate(vehicle.units)
        for place, line in _of_unit(f"units.{i}", unit, loads[i], couplings[i], towed=i > 0)
    )
    return (*of_units, *_of_brakes(vehicle, loads))


def _of_unit(
    path: str, unit: Unit, loads: Sequence[float], coupling: float | None, *, towed: bool
) -> Iterator[tuple[str, str]]:
    place, extent = f"{path} ({unit.name})", _extent(unit, towed=towed)
    axles = sorted((*unit.axles, *unit.lifted_axles), key=lambda axle: -axle.x)  # as in the file
    places = {axle.x: f"{path}.axles.{k} ({unit.name})" for k, axle in enumerate(axles)}
    if coupling is not None and coupling < 0.0:
        yield place, f"its front hitch pulls up with {-coupling / 1e3:.1f} kN"
    of_body = (*_of_body(unit, extent), *_of_cg(unit, extent, towed=towed), *_of_inertias(unit, extent))
    for line in (*of_body, *_of_payload(unit)):
        yield place, line
    for axle in axles:
        yield from ((places[axle.x], line) for line in _of_axle(unit, axle, extent))
    for axle, load in zip(unit.axles, loads, strict=True):
        yield from ((places[axle.x], line) for line in _of_load(axle, load))
    for (ahead, load), (axle, behind) in pairwise(zip(unit.axles, loads, strict=True)):
        yield from ((places[axle.x], line) for line in _of_sharing(ahead, load, axle, behind))


def _of_brakes(vehicle: Vehicle, loads: Sequence[Sequence[float]]) -> Iterator[str]:
    described = False
    for i, unit in enumerate(vehicle.units):
        for k, (axle, load) in enumerate(zip(unit.axles, loads[i], strict=True)):
            if axle.brake is not None:
                described = True
                share = axle.brake.torque / axle.wheel_radius / max(load, 1.0)
                if not _BRAKE[0] <= share <= _BRAKE[1]:
                    yield (
                        f"units.{i}.axles.{k} ({unit.name}): its brakes push with {share:.2g} times its load at full "
                        f"pressure, usual are {_BRAKE[0]:g} to {_BRAKE[1]:g}"
                    )
    if described and vehicle.brakes is None:
        yield "axles have a brake, but without a table [brakes] these data have no effect"


def _extent(unit: Unit, *, towed: bool) -> _Extent:
    rears = [unit.rear_x, *([] if unit.hitch_x is None else [unit.hitch_x - _BEHIND_HITCH])]
    return _Extent(min(rears), max(unit.front_x, 0.0) if towed else unit.front_x)


def _of_body(unit: Unit, extent: _Extent) -> Iterator[str]:
    if unit.hitch_x is not None and unit.hitch_x > extent.front:
        yield f"its rear hitch at x = {unit.hitch_x:g} m lies ahead of it: it reaches from {extent}"
    if unit.follow_x is not None and unit.follow_x < extent.rear - _FOLLOW_MARGIN:
        yield f"its follow point at x = {unit.follow_x:g} m lies behind it: it reaches from {extent}"


def _of_cg(unit: Unit, extent: _Extent, *, towed: bool) -> Iterator[str]:
    supports = _Extent(unit.axles[-1].x, 0.0 if towed else unit.axles[0].x)
    if not extent.holds(unit.cg_x):
        yield f"its centre of gravity at cg_x = {unit.cg_x:g} m lies outside: it reaches from {extent}"
    elif not supports.holds(unit.cg_x):
        base = "hitch and last axle" if towed else "first and last axle"
        yield f"its centre of gravity at cg_x = {unit.cg_x:g} m does not lie between {base}, {supports}"
    if unit.cg_height > unit.height:
        yield f"its centre of gravity at cg_height = {unit.cg_height:g} m lies above its top, {unit.height:g} m"


def _of_inertias(unit: Unit, extent: _Extent) -> Iterator[str]:
    """Radii of gyration: of the yaw inertia, and those that gradients and frequencies of the springs imply.

    A body that pitches or rolls about an axis h below its centre of gravity on springs of stiffness K tilts by m h / K
    per acceleration, and its angular frequency is sqrt(K / (I + m h^2)). So (I + m h^2) / m is h over the gradient and
    the squared frequency. K includes the body's weight, which tips it.
    """
    length = extent.front - extent.rear
    low, high = (share * length for share in _GYRATION)
    yaw = math.sqrt(unit.yaw_inertia / unit.mass)
    if not low <= yaw <= high:
        yield (
            f"yaw_inertia = {unit.yaw_inertia:g} kg m2 is a radius of gyration of {yaw:.2f} m: with a length of "
            f"{length:.2f} m it has {low:.2f} m to {high:.2f} m"
        )
    lever = unit.cg_height - unit.roll_axis_height
    if lever <= 0.0:
        yield (
            f"roll_axis_height = {unit.roll_axis_height:g} m is not below cg_height = {unit.cg_height:g} m: its body "
            "would lean into the turn"
        )
        return
    limits = {
        "roll": (_ROLL_GYRATION * unit.width, 0.5 * math.hypot(unit.width, unit.height)),
        "pitch": (_PITCH_GYRATION[0] * length, _PITCH_GYRATION[1] * length),
    }
    tilts = {"pitch": (unit.pitch_gradient, unit.pitch_frequency)}
    if unit.roll is None:
        tilts = {"roll": unit.roll_swing} | tilts
    else:
        radius, (low, high) = math.sqrt(unit.roll.inertia / unit.mass), limits["roll"]
        if not low <= radius <= high:
            yield (
                f"roll.inertia = {unit.roll.inertia:g} kg m2 is a radius of gyration of {radius:.2f} m: with its width "
                f"and height it has {low:.2f} m to {high:.2f} m"
            )
    for name, (gradient, frequency) in tilts.items():
        squared = lever / (gradient * (math.tau * frequency) ** 2) - lever**2
        radius, (low, high) = math.sqrt(max(squared, 0.0)), limits[name]
        if not low <= radius <= high:
            yield (
                f"{name}_gradient = {gradient:g} rad/(m/s2) and {name}_frequency = {frequency:g} Hz contradict each "
                f"other: they imply a radius of gyration of {radius:.2f} m, it has {low:.2f} m to {high:.2f} m"
            )


def _of_payload(unit: Unit) -> Iterator[str]:
    load = unit.payload
    if load is None:
        return
    if load.mass >= unit.mass:
        yield f"payload.mass = {load.mass:g} kg leaves nothing of its mass of {unit.mass:g} kg, which includes it"
    top = load.cg_height + 0.5 * load.height
    if top > unit.height:
        yield f"its payload reaches {top:.2f} m high, above its top at {unit.height:g} m"
    if load.width > unit.width:
        yield f"payload.width = {load.width:g} m is more than its own, {unit.width:g} m"


def _of_axle(unit: Unit, axle: Axle, extent: _Extent) -> Iterator[str]:
    if not extent.holds(axle.x):
        yield f"at x = {axle.x:g} m it lies outside the unit, which reaches from {extent}"
    if axle.track >= unit.width:
        yield f"track = {axle.track:g} m: its wheels stick out of a width of {unit.width:g} m"
    if axle.ackermann_x is not None and unit.steering is not None:
        lock = min(abs(axle.steer_ratio) * unit.steering.limit, math.radians(89.0))
        if abs(axle.x - axle.ackermann_x) <= 0.5 * axle.track * math.tan(lock):
            yield (
                f"ackermann_x = {axle.ackermann_x:g} m is so near to the axle that its inner wheel turns square before "
                f"the lock of {math.degrees(lock):.0f} deg"
            )
    mass = axle.wheel_inertia / (_RIM * axle.wheel_radius) ** 2
    low, high = (density * axle.wheel_radius**3 for density in _WHEEL)
    if not low <= mass <= high:
        yield (
            f"wheel_inertia = {axle.wheel_inertia:g} kg m2 is a wheel of {mass:.3g} kg; with a radius of "
            f"{axle.wheel_radius:g} m it has {low:.0f} kg to {high:.0f} kg"
        )


def _of_load(axle: Axle, load: float) -> Iterator[str]:
    least, most = (float(limit) for limit in axle.tyre.load_range)
    if load <= 0.0:
        yield f"carries {load / 1e3:.1f} kN, it must be above 0 kN to stay on the ground"
    if not least <= 0.5 * load <= most:
        share = f"{0.5 * load / axle.tyre.nominal_load:.1f} times its tyres' nominal load"
        yield f"{share}: {0.5 * load / 1e3:.1f} kN a wheel, its tyre data are for {least / 1e3:g} to {most / 1e3:g} kN"
    if load > _LARGEST_AXLE_LOAD:
        heaviest = f"{_LARGEST_AXLE_LOAD / GRAVITY / 1e3:g} t"
        yield f"carries {load / GRAVITY / 1e3:.1f} t, more than the {heaviest} of four truck tyres"


def _of_sharing(ahead: Axle, load: float, axle: Axle, behind: float) -> Iterator[str]:
    """Neighbours in a group share as their suspension says: equally, or in the ratio of ``load_share``."""
    if ahead.x - axle.x > _CLOSE or min(load, behind) <= 0.0:
        return
    by_share = (load / ahead.load_share, behind / axle.load_share)
    between = f"it carries {behind / GRAVITY / 1e3:.1f} t and its neighbour ahead {load / GRAVITY / 1e3:.1f} t"
    if min(by_share) < _EQUAL * max(by_share):
        yield f"{between}, only {ahead.x - axle.x:.2f} m apart: name a bogie for both if a suspension equalises them"
    elif min(load, behind) < _TOO_UNEQUAL * max(load, behind):
        shares = f"load_share {axle.load_share:g} and {ahead.load_share:g}"
        yield f"{between}: with {shares} the axles of a group share too unequally"


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
    loads, couplings = static_axle_loads(vehicle), coupling_loads(vehicle)
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
        for i, (unit, origin) in enumerate(zip(vehicle.units, vehicle.origins, strict=True))
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


def coupling_loads(vehicle: Vehicle) -> tuple[float | None, ...]:
    """Load [N] that each unit's front hitch puts on the unit ahead, on level ground; None for the tractor."""
    loads: list[float | None] = []
    below = 0.0
    for unit, axles in zip(reversed(vehicle.units), reversed(static_axle_loads(vehicle)), strict=True):
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
    steering = unit.steering_of(axle)
    largest = steering.limit * abs(axle.steer_ratio) if steering else 0.0
    return min(largest, _SQUARE)


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
