"""A rover's data sheet: wheel loads, tipping, speeds, turning, and its traction in each soil.

Wheel loads follow from the balance of forces and moments of a standing rover. Traction is that of steady straight
driving: driven wheels have the same slip, the others roll freely, and each sinks until the soil carries its load.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple

import casadi as ca
import numpy as np
import scipy

from vehicle.frames import FloatArray
from vehicle.rover.description import Rover, Soil
from vehicle.rover.terramechanics import GRAVITY, RimMotion, soil_force

Direction = Literal["uphill", "downhill", "sideways"]

STANDARD_SLIP: Final = 0.2  # slip ratio at which drawbar pull is usually compared [-]
_SLIPS: Final = tuple(0.05 * k for k in range(20))  # [-] tried; at 1 the rover stands still
_LARGEST_SKID: Final = 0.95  # of a wheel without a drive [-]
_ANGLE_TOLERANCE, _SLIP_TOLERANCE = 1e-4, 1e-4  # of the steepest climb [rad], of a free wheel's skid [-]
_SMALLEST_SPREAD: Final = 1e-12  # of supports side by side [m2]


@dataclass(frozen=True, slots=True, kw_only=True)
class TippingSlope:
    """Slope on which a rover is about to tip, heading uphill, downhill or along the contour with its left side up."""

    direction: Direction
    angle: float  # [rad]
    loads: tuple[float, ...]  # of the wheels there, normal to the ground [N]


@dataclass(frozen=True, slots=True, kw_only=True)
class Traction:
    """Steady straight driving in one soil; None where the soil does not carry the rover."""

    soil: str
    summary: str
    sinkage: float | None  # of the wheel that sinks most, rolling without slip, on level ground [m]
    pull: float | None  # drawbar pull of all wheels at ``STANDARD_SLIP``, on level ground [N]
    largest_pull: float | None  # over all slips without entrapment [N]
    largest_pull_slip: float | None  # [-]
    entrapped_from: float | None  # slip ratio from which it is entrapped on level ground [-]; None: at no slip
    steepest_climb: float  # slope that it climbs without entrapment [rad]; 0 if none


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverSheet:
    """Data sheet of a rover."""

    rover: Rover
    positions: FloatArray  # (n, 2) of the wheels in R [m]
    length: float  # over the wheels [m]
    width: float  # over the wheels [m]
    loads: tuple[float, ...]  # of the wheels on level ground [N]
    tipping: tuple[TippingSlope, ...]
    top_speed: float  # of a rover whose wheels turn at their no-load speed and do not slip [m/s]
    stall_thrust: float  # of all driven wheels at the motors' stall torque [N]
    turning_radius: float | None  # smallest, of the body centre [m]; 0: turns on the spot; None: no wheel steers
    traction: tuple[Traction, ...]


def rover_sheet(rover: Rover, soils: Iterable[Soil]) -> RoverSheet:
    """Data sheet of a rover, with its traction in these soils."""
    positions = rover.wheel_places
    return RoverSheet(
        rover=rover,
        positions=positions,
        length=float(np.ptp(positions[:, 0])) + 2.0 * rover.radius,
        width=float(np.ptp(positions[:, 1])) + rover.width,
        loads=_plain(_loads(rover, 0.0)),
        tipping=tuple(_tipping(rover, direction) for direction in ("uphill", "downhill", "sideways")),
        top_speed=rover.no_load_speed * rover.radius,
        stall_thrust=sum(wheel.driven for wheel in rover.wheels) * rover.stall_torque / rover.radius,
        turning_radius=_turning_radius(rover) if rover.steered else None,
        traction=tuple(_traction(rover, soil) for soil in soils),
    )


def _turning_radius(rover: Rover) -> float:
    """Smallest turning radius of the body centre [m]; it turns about a point abreast of wheels without steering."""
    fixed = [wheel.x for wheel in rover.wheels if not wheel.steered]
    abreast = math.fsum(fixed) / len(fixed) if fixed else 0.0
    steered = [(abs(wheel.x - abreast), abs(wheel.y)) for wheel in rover.wheels if wheel.steered]
    if all(math.atan2(x, y) <= rover.steer_limit for x, y in steered):
        return abs(abreast)
    return math.hypot(abreast, max(y + x / math.tan(rover.steer_limit) for x, y in steered))


def _loads(rover: Rover, climb: float) -> FloatArray:
    """Wheel loads [N] of a rover that stands or climbs steadily on a slope [rad] straight ahead; none below 0."""
    normal = rover.mass * GRAVITY * math.cos(climb)
    pitch = normal * (rover.cg_x - rover.cg_height * math.tan(climb))
    return np.array([float(load) for load in rover.footprint.loads(normal, pitch, 0.0)])


def _shares(stations: FloatArray, centre: float) -> FloatArray:
    """Shares of a load that acts at ``centre`` [m], varying linearly over the supports' stations (n,) [m]."""
    offsets = stations - np.mean(stations)
    spread = max(float(np.sum(offsets**2)), _SMALLEST_SPREAD)
    return np.asarray(1.0 / len(stations) + (centre - np.mean(stations)) * offsets / spread)


def _tipping(rover: Rover, direction: Direction) -> TippingSlope:
    """The rover tips when its weight acts through the line of its lowest wheels, which then carry all of it."""
    x, y = rover.wheel_places.T
    downhill = {"uphill": -(x - rover.cg_x), "downhill": x - rover.cg_x, "sideways": -y}[direction]
    angle = math.atan2(float(np.max(downhill)), rover.cg_height)
    lowest = np.isclose(downhill, np.max(downhill))
    loads = np.zeros(len(x))
    loads[lowest] = rover.mass * GRAVITY * math.cos(angle) * _shares(x[lowest], rover.cg_x)
    return TippingSlope(direction=direction, angle=angle, loads=_plain(loads))


@lru_cache(maxsize=32)
def _traction(rover: Rover, soil: Soil) -> Traction:
    level = _loads(rover, 0.0)
    rolling = _rolling(rover, soil, float(np.max(level)), 0.0)
    pulls = {slip: pull for slip in _SLIPS if (pull := _pull(rover, soil, level, slip)) is not None}
    best = max(pulls, key=pulls.__getitem__, default=None)
    return Traction(
        soil=soil.name,
        summary=soil.summary,
        sinkage=None if rolling is None else rolling.sinkage,
        pull=_pull(rover, soil, level, STANDARD_SLIP),
        largest_pull=None if best is None else pulls[best],
        largest_pull_slip=best,
        entrapped_from=_entrapped_from(rover, soil, level),
        steepest_climb=_steepest_climb(rover, soil),
    )


def _entrapped_from(rover: Rover, soil: Soil, loads: FloatArray) -> float | None:
    """Smallest slip ratio at which a wheel sinks to the limit; the soil carries least there when it slips most."""
    heaviest = float(np.max(loads))

    def spare(slip: float) -> float:
        return float(_wheel_force(rover, soil)(rover.sinkage_limit, 1.0 - slip)[1]) - heaviest

    if spare(1.0) > 0.0:
        return None
    return 0.0 if spare(0.0) <= 0.0 else float(scipy.optimize.brentq(spare, 0.0, 1.0, xtol=1e-6))


def _steepest_climb(rover: Rover, soil: Soil) -> float:
    """Steepest slope [rad] on which some slip gives the pull that the weight asks for; 0 if the level is too much."""

    def climbs(angle: float) -> bool:
        loads, needed = _loads(rover, angle), rover.mass * GRAVITY * math.sin(angle)
        pulls = (_pull(rover, soil, loads, slip) for slip in reversed(_SLIPS))
        return any(pull is not None and pull >= needed for pull in pulls)

    low, high = 0.0, _tipping(rover, "uphill").angle
    if not climbs(low):
        return 0.0
    while high - low > _ANGLE_TOLERANCE:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if climbs(middle) else (low, middle)
    return low


def _pull(rover: Rover, soil: Soil, loads: FloatArray, slip: float) -> float | None:
    """Drawbar pull [N] of all wheels at a slip ratio; None if a wheel sinks beyond the limit or its motor stalls."""
    driven = [wheel.driven for wheel in rover.wheels]
    total = 0.0
    for (load, powered), count in Counter(zip(loads.tolist(), driven, strict=True)).items():
        wheel = _rolling(rover, soil, load, slip) if powered else _rolling_freely(rover, soil, load)
        if wheel is None or wheel.sinkage > rover.sinkage_limit or wheel.torque > rover.stall_torque:
            return None
        total += count * wheel.pull
    return total


class _SteadyWheel(NamedTuple):
    """A wheel in soil that carries its load."""

    sinkage: float  # [m]
    pull: float  # [N]
    torque: float  # on the axle, against the rotation [N m]


def _rolling(rover: Rover, soil: Soil, load: float, slip: float) -> _SteadyWheel | None:
    """A wheel under a load [N] that rolls with a slip ratio; None if it sinks in up to its axle."""
    force = _wheel_force(rover, soil)
    along = 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)

    def spare(sinkage: float) -> float:
        return float(force(sinkage, along)[1]) - load

    if spare(rover.radius) < 0.0:
        return None
    sinkage = 0.0 if spare(0.0) >= 0.0 else float(scipy.optimize.brentq(spare, 0.0, rover.radius, xtol=1e-9))
    pull, _, torque = force(sinkage, along)
    return _SteadyWheel(sinkage, float(pull), float(torque))


def _rolling_freely(rover: Rover, soil: Soil, load: float) -> _SteadyWheel | None:
    """A wheel without a drive under a load [N]: it skids until the torque on its axle vanishes."""

    def torque(slip: float) -> float:
        wheel = _rolling(rover, soil, load, slip)
        return -math.inf if wheel is None else wheel.torque

    low, high = -_LARGEST_SKID, 0.0
    while high - low > _SLIP_TOLERANCE:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if torque(middle) > 0.0 else (middle, high)
    return _rolling(rover, soil, load, high)


@lru_cache(maxsize=16)
def _wheel_force(rover: Rover, soil: Soil) -> Any:
    """CasADi function: sinkage [m] and speed over rim speed [-] to pull, lift [N] and torque [N m]."""
    sinkage, along = ca.SX.sym("sinkage"), ca.SX.sym("along")
    force = soil_force(rover, soil, sinkage, RimMotion(along, 0.0))
    return ca.Function("wheel_force", [sinkage, along], [force.F_x, force.F_z, force.torque])


def _plain(loads: FloatArray) -> tuple[float, ...]:
    return tuple(float(load) for load in loads)
