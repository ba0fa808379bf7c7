"""A combination driven by a law on open ground without cameras, the standard manoeuvres and their results."""

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Final, Literal, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.driver import PERIOD as DRIVER_PERIOD
from controllers.driver import DriverCommand, DriverLike, PreviewDriver
from controllers.trailer import Combination
from estimators.off_tracking.reference import ReferenceOffTracking
from scenarios.assembly.adapters import tractor_guided_at, trailer_geometry
from scenarios.assembly.drivers_and_laws import trailer_law
from scenarios.assembly.trailer_run import Sensing, WatchedTrailer
from scenarios.courses import Course
from scenarios.loop.channel import InLine, Stopwatch
from scenarios.loop.referee import Referee
from scenarios.loop.session import Session
from scenarios.loop.trailer_session import CombinationPilot, SteeredTrailer
from scenarios.results.log import Column, Log, Signal
from scenarios.results.swept_path import placed
from scenarios.results.trailer_signals import tyre_columns, unit_columns
from sensors.instruments.combination import CombinationSensors
from sensors.instruments.navigation import ExactPose
from sensors.messages import EgoState
from vehicle.clock import TICK, Schedule, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import Plant
from vehicle.combination.truth import Truth
from vehicle.foundation.own_parts import close_part
from vehicle.frames import FloatArray, Pose2
from vehicle.option import Parameter
from vehicle.surface import Surface

_ESTIMATES = Schedule.at_rate(10.0)  # of the off-tracking: a 10 Hz camera's
_CRUISE_GAIN = 2.0  # acceleration demand per speed error [1/s]
_CRUISE_INTEGRAL = 1.0  # [1/s2]: aperiodic with the gain above


class ChosenLaw(str):
    """Name of a steering law, with values of its parameters."""

    parameters: Mapping[str, Parameter]

    def __new__(cls, name: str, parameters: Mapping[str, Parameter] = MappingProxyType({})) -> Self:
        """Of a law with other values than its own."""
        chosen = super().__new__(cls, name)
        chosen.parameters = dict(parameters)
        return chosen


def steered_trailer(vehicle: Vehicle, law: str) -> WatchedTrailer | None:
    """The last unit with a steering law that knows the exact off-tracking; None for ``none``: all axles stay straight.

    Raises:
        ValueError: one line, if the last unit has no steered axle, or there is no such law.
    """
    if law == "none":
        return None
    last = len(vehicle.units) - 1
    if last == 0 or not vehicle.units[last].steered_axles:
        raise ValueError(f"trailer_steering = {law}: the last unit of {vehicle.name} has no steered axle")
    geometry = trailer_geometry(vehicle, last)
    return WatchedTrailer(
        unit=last,
        name=vehicle.units[last].name,
        geometry=geometry,
        path_height=vehicle.units[last].roll_axis_height,
        steers_ahead=sum(len(unit.steered_axles) for unit in vehicle.units[:last]),
        law=trailer_law(law, geometry, Combination(vehicle, last), getattr(law, "parameters", {})),
        signals=CombinationSensors(vehicle, last, rng=np.random.default_rng(0), noise=0.0),
        sensing=Sensing(
            sensor=ExactPose(last, vehicle.units[last].roll_axis_height),
            schedule=_ESTIMATES,
            period=_ESTIMATES.period,
            estimator=ReferenceOffTracking(geometry.follow_distance),
            cameras=None,
        ),
    )


class SpeedHold:
    """Speed control of the robots: proportional and integral."""

    @staticmethod
    def step(held: float, error: float, duration: float) -> tuple[float, float]:
        """New memory and demanded acceleration [m/s2] for a speed error [m/s], ``duration`` [s] after the last step."""
        held = held + _CRUISE_INTEGRAL * error * duration
        return held, _CRUISE_GAIN * error + held


class SteerProgramme:
    """A steering robot: road-wheel angles over time, open loop, at a speed that is held."""

    def __init__(self, angles: FloatArray, speed: float, period: int) -> None:
        """Steer by ``angles`` (n,) [rad], one every ``period`` [ticks]; the last one stays."""
        self._angles, self._speed, self._period = angles, speed, period

    def init(self) -> float:
        """Acceleration that holds the speed, before the first step [m/s2]."""
        return 0.0

    def step(self, held: float, tick: int, ego: EgoState) -> tuple[float, DriverCommand]:
        """New memory and command at ``tick``."""
        held, acceleration = SpeedHold.step(held, self._speed - ego.v_x, self._period * TICK)
        steer = float(self._angles[min(tick // self._period, len(self._angles) - 1)])
        return held, DriverCommand(steer=steer, acceleration=acceleration)


def half_sine(peak: float, duration: float, start: float, count: int, period: int) -> FloatArray:
    """A pulse of steer: half a sine of height ``peak`` [rad], ``duration`` [s] long from ``start`` [s] on.

    Shape (count,), one value every ``period`` [ticks].
    """
    phase = (np.arange(count) * period * TICK - start) / duration
    pulse: FloatArray = np.where((phase > 0.0) & (phase < 1.0), peak * np.sin(math.pi * phase), 0.0)
    return pulse


MemoryT = TypeVar("MemoryT")

PERIOD: Final = to_ticks(DRIVER_PERIOD, "control period")  # of pilots and log alike [ticks]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """A finished drive."""

    outcome: str  # "completed" or the mishap
    log: Log


class ManoeuvreJudge:
    """Ends a drive when its manoeuvre is over, at a mishap, or when it takes too long."""

    def __init__(self, vehicle: Vehicle, done: Callable[[Truth], bool], patience: float) -> None:
        """Wait ``patience`` [s] at most until the manoeuvre is ``done``; there is no road to leave."""
        self._referee = Referee(vehicle)
        self._memory = self._referee.init()
        self._done, self._patience = done, patience

    @property
    def progress(self) -> float:
        """A manoeuvre is done or not."""
        return 0.0

    def outcome(self, truth: Truth) -> str | None:
        """Outcome of the drive; None if it continues."""
        self._memory, mishap = self._referee.step(self._memory, truth)
        if mishap is not None:
            return mishap
        if self._done(truth):
            return "completed"
        return "timed out" if truth.tick * TICK > self._patience else None


def drive(
    vehicle: Vehicle,
    surface: Surface,
    driver: DriverLike[MemoryT],
    *,
    trailer_steering: str,
    speed: float,
    done: Callable[[Truth], bool],
    patience: float,
) -> Drive:
    """Drive a combination from the origin along +x, rolling straight at first.

    Args:
        vehicle: the combination.
        surface: the ground; there is no road to leave.
        driver: of the tractor, asked every ``PERIOD``.
        trailer_steering: law of the last unit's steered axles.
        speed: at the start [m/s].
        done: true once the manoeuvre is over.
        patience: longest duration [s].
    """
    stopwatch, plant = Stopwatch(), Plant(vehicle, surface)
    watched = steered_trailer(vehicle, trailer_steering)
    trailers = () if watched is None else (SteeredTrailer(watched, InLine(), stopwatch),)
    session = Session(
        plant,
        plant.initial_state(Pose2(0.0, 0.0, 0.0), speed),
        period=PERIOD,
        pilot=CombinationPilot(vehicle, driver, trailers),
        judge=ManoeuvreJudge(vehicle, done, patience),
        channels=[trailer.channel for trailer in trailers],
        stopwatch=stopwatch,
    )
    try:
        while session.outcome is None:
            session.advance()
    finally:
        close_part(watched)
    return Drive(outcome=session.outcome, log=drive_log(vehicle, [row.truth for row in session.rows]))


def drive_programme(
    vehicle: Vehicle, surface: Surface, angles: FloatArray, *, speed: float, trailer_steering: str
) -> Drive:
    """Drive a programme of steer angles (n,) [rad], one every ``PERIOD``, at a speed [m/s]."""
    end = len(angles) * PERIOD
    return drive(
        vehicle,
        surface,
        SteerProgramme(angles, speed, PERIOD),
        trailer_steering=trailer_steering,
        speed=speed,
        done=lambda truth: truth.tick >= end,
        patience=2.0 * end * TICK,
    )


def drive_course(
    vehicle: Vehicle,
    course: Course,
    surface: Surface,
    *,
    speed: float,
    trailer_steering: str = "none",
    done: Callable[[Truth], bool],
    driver: Callable[[PreviewDriver], DriverLike[Any]] = lambda preview: preview,
    patience: float | None = None,
) -> Drive:
    """Drive a course at a speed [m/s] by the preview driver, or by one that uses him.

    The longest duration is ``patience`` [s], by default twice the usual one.
    """
    preview = PreviewDriver(tractor_guided_at(vehicle, course.reference), course.path, speed)
    return drive(
        vehicle,
        surface,
        driver(preview),
        trailer_steering=trailer_steering,
        speed=speed,
        done=done,
        patience=patience or 2.0 * course.length / speed,
    )


def drive_log(vehicle: Vehicle, truths: Sequence[Truth]) -> Log:
    """The log of a drive, a row for each of the truths, in the names of a run's log."""
    return Log.of(_columns(vehicle, truths))


def _columns(vehicle: Vehicle, truths: Sequence[Truth]) -> Iterator[Column]:
    yield Signal("time", "s", "time"), [truth.tick * TICK for truth in truths]
    for k, unit in enumerate(vehicle.units):
        yield from unit_columns(truths, k, unit.name)
        transfer = Signal(f"load_transfer_{unit.name}", "-", f"{unit.name}: right less left wheel loads over their sum")
        yield transfer, [truth.load_transfer[k] for truth in truths]
    steer = Signal("steer_tractor", "rad", "road-wheel angle of the first steered axle, + left")
    yield steer, [truth.steer[0] for truth in truths]
    tractor = vehicle.units[0]
    first = tractor.axles.index(tractor.steered_axles[0])
    wheels = slice(2 * first, 2 * first + 2)  # wheels are listed axle by axle, tractor first
    used = Signal(
        "friction_used_steer", "-", "horizontal over available tyre force, all wheels of the first steered axle"
    )
    yield used, [np.average(truth.friction_used[wheels], weights=truth.wheel_loads[wheels]) for truth in truths]
    yield from tyre_columns(truths)


Hand = Literal["left", "right"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """Changes of a manoeuvre's conditions; None: as the standard prescribes."""

    hand: Hand = "left"  # side to which it turns first
    speed: float | None = None  # [m/s]
    radius: float | None = None  # of the guided point's path [m]
    friction: float | None = None  # [-]


STANDARD: Final = Conditions()


class Setting(NamedTuple):
    """Conditions under which a manoeuvre is driven; 0: it has no such condition."""

    hand: Hand
    speed: float  # [m/s]
    radius: float  # [m]
    friction: float  # [-]

    @property
    def side(self) -> float:
        """+1 to the left, -1 to the right."""
        return 1.0 if self.hand == "left" else -1.0

    @property
    def surface(self) -> Surface:
        """Level ground of this friction."""
        return Surface(friction=self.friction)


Limits = tuple[float, float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of manoeuvre, its standard's conditions, and the limits of those that can be chosen; None: it has none."""

    key: str
    line: str  # what it is
    title: str
    seconds: float  # of driving, about; longer ones are started first
    quantities: tuple[str, ...]  # that are measured
    speed: float = 0.0  # [m/s]
    radius: float = 0.0  # [m]
    friction: float = 0.8  # [-]: a dry road
    speeds: Limits = None  # [m/s]
    radii: Limits = None  # [m]
    frictions: Limits = None  # [-]
    handed: bool = True  # it turns to one side first

    @classmethod
    def of(cls, key: str, table: dict[str, Any]) -> "Kind":
        """The manoeuvre of a table of ``manoeuvres.toml``."""
        speeds, radii, frictions = (
            tuple(table.pop(name)) if name in table else None
            for name in ("speed_limits_kmh", "radius_limits_m", "friction_limits")
        )
        return cls(
            key=key,
            speed=table.pop("speed_kmh", 0.0) / 3.6,
            radius=table.pop("radius_m", 0.0),
            speeds=(speeds[0] / 3.6, speeds[1] / 3.6) if speeds else None,
            radii=radii,
            frictions=frictions,
            quantities=tuple(table.pop("quantities")),
            **table,
        )

    def under(self, conditions: Conditions) -> Setting:
        """The standard's conditions with these changes."""
        return Setting(
            conditions.hand,
            self.speed if conditions.speed is None else conditions.speed,
            self.radius if conditions.radius is None else conditions.radius,
            self.friction if conditions.friction is None else conditions.friction,
        )

    def differs(self, conditions: Conditions) -> bool:
        """True if the manoeuvre is driven under other conditions than the standard's."""
        changed = conditions.speed, conditions.radius, conditions.friction
        limits = self.speeds, self.radii, self.frictions
        return any(value is not None and limit for value, limit in zip(changed, limits, strict=True))


def read_tables(name: str) -> dict[str, Any]:
    """The tables of a file of this folder."""
    return tomllib.loads((files("offtrack.studies.standards") / name).read_text(encoding="utf-8"))


KINDS: Final = {key: Kind.of(key, table) for key, table in read_tables("manoeuvres.toml").items()}
Figures = Mapping[str, float]  # value of each quantity by name, in SI units; NaN if it could not be measured


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Manoeuvre:
    """Result of one standard manoeuvre."""

    key: str  # "turn", "roundabout", …
    title: str
    how: str  # description of the test
    outcome: str  # "completed" or the mishap
    figures: Figures
    log: Log
    conditions: Conditions = STANDARD
    course: FloatArray | None = None  # (n, 2) path of the guided point, if there is one [m]


def result(
    key: str,
    how: str,
    driven: Drive,
    figures: Callable[[], Figures],
    *,
    conditions: Conditions = STANDARD,
    course: FloatArray | None = None,
) -> Manoeuvre:
    """Result of a manoeuvre; all its quantities are NaN if it was not completed."""
    kind, values = KINDS[key], figures() if driven.outcome == "completed" else {}
    return Manoeuvre(
        key=key,
        title=kind.title,
        how=how,
        outcome=driven.outcome,
        figures={name: float(values.get(name, math.nan)) for name in kind.quantities},
        log=driven.log,
        conditions=conditions,
        course=course,
    )


def path_error(guided: FloatArray, course: Course) -> float:
    """Largest distance [m] of a point's path (n, 2) from the course's."""
    station, errors = 0.0, []
    for x, y in guided.tolist():
        station = course.path.project(x, y, station)
        errors.append(math.dist((x, y), course.path.pose(station)[:2]))
    return max(errors)


def largest_articulation(vehicle: Vehicle, log: Log, side: float = 0.0) -> float:
    """Largest articulation [rad] of any hitch, to one side (+1 left), or to both; NaN without a hitch."""
    pairs = pairwise(unit.name for unit in vehicle.units)
    angles = (articulation(log, *pair) for pair in pairs)
    return max((float((side * angle if side else np.abs(angle)).max()) for angle in angles), default=math.nan)


def largest_load_transfer(vehicle: Vehicle, log: Log) -> float:
    """Largest magnitude of the load transfer of any unit [-]."""
    return max(float(np.max(np.abs(log[f"load_transfer_{unit.name}"]))) for unit in vehicle.units)


def axle_paths(vehicle: Vehicle, log: Log) -> tuple[FloatArray, FloatArray]:
    """Paths (n, 2) of the first steered and of the last axle [m]."""
    first, last = vehicle.units[0], vehicle.units[-1]
    return point_path(log, first.name, first.steered_axles[0].x), point_path(log, last.name, last.axles[-1].x)


_NOISE = 1e-3  # over the largest extreme; smaller extremes are not counted


def point_path(log: Log, unit: str, x: float, y: float = 0.0) -> FloatArray:
    """Path of a unit's point at x, y [m] in its frame, shape (n, 2) in the world."""
    poses = np.column_stack([log[f"{quantity}_{unit}"] for quantity in ("x", "y", "psi")])
    return placed(np.array([[x, y]]), poses)[:, 0]


def lateral_acceleration(log: Log, unit: str, x: float) -> FloatArray:
    """Lateral acceleration of a unit at x [m] on its axis [m/s2], + left, shape (n,).

    Of the motion over the ground, as in ISO 14791: without gravity and body roll.
    """
    lateral = log[f"v_y_{unit}"] + x * log[f"yaw_rate_{unit}"]
    along = log[f"v_x_{unit}"] * log[f"yaw_rate_{unit}"]
    acceleration: FloatArray = np.gradient(lateral, log["time"]) + along
    return acceleration


def articulation(log: Log, ahead: str, behind: str) -> FloatArray:
    """Yaw of the unit ahead minus yaw of the unit behind [rad], + in a left turn, shape (n,)."""
    angle: FloatArray = log[f"psi_{ahead}"] - log[f"psi_{behind}"]
    return angle


def amplification(behind: FloatArray, ahead: FloatArray) -> float:
    """Rearward amplification: largest magnitude of the unit behind over that of the unit ahead [-]."""
    return float(np.max(np.abs(behind)) / np.max(np.abs(ahead)))


def damping(values: FloatArray) -> float:
    """Damping ratio of a freely decaying oscillation about zero, from its extremes; 1 if it hardly oscillates.

    With a damping ratio D, consecutive extremes on opposite sides differ by the factor exp(pi D / sqrt(1 - D^2)).
    ISO 14791 averages these factors. The first extreme still depends on the excitation; it is omitted if there are more
    than two. Extremes below a thousandth of the largest are not counted.
    """
    heights = _extremes(values)
    heights = heights[heights > _NOISE * heights.max()] if heights.size else heights
    heights = heights[1:] if heights.size > 2 else heights
    if heights.size < 2:
        return 1.0
    decrement = math.log(float(np.mean(heights[:-1] / heights[1:])))
    return decrement / math.hypot(math.pi, decrement)


def _extremes(values: FloatArray) -> FloatArray:
    """Largest magnitude between consecutive changes of sign; the last, unfinished stretch is omitted."""
    crossings: NDArray[np.intp] = np.flatnonzero(np.diff(np.sign(values)) != 0.0) + 1
    return np.array([float(np.abs(stretch).max()) for stretch in np.split(values, crossings)[:-1]])


def overshoot(behind: FloatArray, ahead: FloatArray) -> float:
    """Largest distance [m] of a path (n, 2) along x to the left of another one; at least zero.

    In a lane change to the left this is the transient off-tracking of the last axle from the first.
    """
    lateral = behind[:, 1] - np.interp(behind[:, 0], ahead[:, 0], ahead[:, 1])
    return max(0.0, float(np.max(lateral)))
