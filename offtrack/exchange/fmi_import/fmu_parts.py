"""FMUs as trailer steering laws, as drivers and as sources of off-tracking.

Such an FMU gets the motion of the combination, as a sensor does, and gives estimates.
"""

import copy
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, Self

import numpy as np

from controllers.driver import DriverCommand, DriverLike, DriverMemory, PreviewDriver
from controllers.trailer import Combination, SteerCommand, SteeringLaw, TrailerGeometry
from estimators.context import TrailerContext
from estimators.estimates import OffTracking
from offtrack.exchange.fmi_import import numbered_signals
from offtrack.exchange.fmi_import.fmu_file import FmuFile, open_fmu, options_of
from offtrack.exchange.fmi_import.fmu_plant import plant_signals
from offtrack.exchange.fmi_import.instance import FmuInstance
from offtrack.exchange.fmi_import.mapping import PartSignals, Signal, read_map
from scenarios.assembly.drivers_and_laws import DriverContext
from scenarios.assembly.trailer_sensors import MountContext, OpenedSensor
from scenarios.courses import Course
from sensors.messages import CombinationSignals, EgoState
from vehicle.clock import TICK, Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.option import Option, Parameter, check_options


class FmuPart:
    """A part that is an FMU in a process of its own."""

    fmu: ClassVar[FmuFile]
    options: ClassVar[tuple[Option, ...]] = ()
    _instance: FmuInstance

    @classmethod
    def of_file(cls, file: str) -> type[Self]:
        """Class of such a part of an FMU.

        Raises:
            ValueError: one line, if it is no FMU that runs here.
        """
        fmu = open_fmu(Path(file))
        return type(cls.__name__, (cls,), {"fmu": fmu, "options": options_of(fmu)})

    @classmethod
    def of(cls, context: Any) -> Self:
        """Part for the context of a run.

        Raises:
            ValueError: one line, if the map does not fit or the FMU can't be started.
        """
        made: Any = cls
        return made(context)  # type: ignore[no-any-return]

    def _start(self, key: str, signals: PartSignals, parameters: Mapping[str, Parameter], **others: float) -> None:
        """Start the FMU with parameters of the scenario's table ``key``, and ``others`` that it does not give.

        Raises:
            ValueError: one line, if the map does not fit or the FMU can't be started.
        """
        check_options(self.options, parameters, key)
        given = others | {name: float(value) for name, value in parameters.items()}
        self._instance = FmuInstance(self.fmu, read_map(self.fmu, signals), given)

    def close(self) -> None:
        """End the FMU's process."""
        self._instance.close()


def law_signals(n_steered: int, n_units: int, groups: Iterable[tuple[int, ...]] = ()) -> PartSignals:
    """Signals of a law for a trailer with ``n_steered`` steered axles in a combination of ``n_units``.

    Of ``groups`` of axles that share an actuator, one demand is enough.
    """
    ganged = {axle: tuple(f"steer_demand_{other + 1}" for other in group) for group in groups for axle in group}
    return PartSignals(
        kind="trailer_steering",
        inputs=(
            Signal("time", "s", "since the start"),
            *numbered_signals.estimate_signals(coarse=True),
            *numbered_signals.reading_signals(n_steered, n_units),
        ),
        outputs=tuple(
            Signal(
                f"steer_demand_{k + 1}",
                "rad",
                f"of steered axle {k + 1} of the trailer, + left",
                required=True,
                instead=ganged.get(k, ()),
            )
            for k in range(n_steered)
        ),
    )


class FmuLaw(FmuPart, SteeringLaw[int]):
    """A trailer steering law that is an FMU; its memory is the tick at which the FMU's time began.

    It is stepped, by the period of its map, past the moment of every call, with the signals of that moment. Its outputs
    of the end of the step are the command until the next one: a law that computes its outputs in the step acts without
    delay.
    """

    def __init__(self, trailer: TrailerGeometry, *, combination: Combination, **parameters: Parameter) -> None:
        """For the trailer of a combination, with parameters of the FMU.

        Raises:
            ValueError: one line, if the map does not fit.
            FmuError: one line, if the FMU can't be started.
        """
        n = len(trailer.steered_distances)
        self._trailer = trailer
        own = self.fmu.tool == "offtrack" and "guarded" in self.fmu.variables
        unguarded = {"guarded": 0.0} if own else {}  # the run guards it itself, as ``degradation`` says
        signals = law_signals(n, len(combination.vehicle.units), trailer.groups)
        self._start("steering", signals, parameters, **unguarded)
        self._command = np.zeros(n)

    def init(self) -> int:
        """Memory before the first step."""
        return -1

    def step(
        self, memory: int, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[int, SteerCommand]:
        """Command at ``tick``.

        Raises:
            FmuError: if the FMU fails, stalls, crashes or gives no finite number.
        """
        instance = self._instance
        if memory < 0 and instance.ticks > 0:
            instance.restart()
        memory = tick if memory < 0 else memory
        if instance.ticks <= tick - memory:
            estimate = numbered_signals.estimate_values(tick, off_tracking, instance.used)
            given = {"time": tick * TICK, **numbered_signals.reading_values(signals), **estimate}
            found = instance.until(tick - memory, given)
            self._command = self._demands(found)
        return memory, SteerCommand(angles=self._command)

    def _demands(self, found: Mapping[str, float]) -> FloatArray:
        """Demands (n_steered,) [rad]; axles without one of their own follow the first of their group that has one."""
        demands, ratios = np.zeros(len(self._trailer.straight)), self._trailer.steer_ratios
        for group in self._trailer.groups:
            given = {axle: found[name] for axle in group if (name := f"steer_demand_{axle + 1}") in found}
            first = next(iter(given))
            for axle in group:
                demands[axle] = given.get(axle, given[first] / ratios[first] * ratios[axle])
        return demands


_AHEAD: Final = 60  # points of the path that an FMU can take, a metre apart


def driver_signals(n_units: int) -> PartSignals:
    """Signals of a driver of a combination of ``n_units``."""
    points = range(_AHEAD + 1)
    return PartSignals(
        kind="driver",
        inputs=(
            Signal("time", "s", "since the start"),
            Signal("set_speed", "m/s", "speed that the scenario asks for"),
            *numbered_signals.MOTION,
            *numbered_signals.articulation_signals(n_units),
            Signal("station", "m", "of the guided point along the path"),
            Signal("lateral_error", "m", "of the guided point from the path, + when it lies left of the path"),
            Signal("heading_error", "rad", "tractor's heading minus that of the path at the guided point"),
            Signal("curvature", "1/m", "of the path at the guided point, + left"),
            *(Signal(f"ahead_x_{k}", "m", f"path {k} m further, in the tractor's frame") for k in points),
            *(Signal(f"ahead_y_{k}", "m", f"path {k} m further, in the tractor's frame") for k in points),
        ),
        outputs=(
            Signal("steer", "rad", "road-wheel angle of the tractor's foremost steered axle, + left", required=True),
            Signal("acceleration", "m/s2", "above 0 drives, below 0 brakes; not connected: the set speed is kept"),
            Signal("gear", "-", "1 forward, -1 backward"),
        ),
    )  # fmt: skip


class FmuDriverMemory(NamedTuple):
    """State of the driver between two steps."""

    start: int  # tick at which the FMU's time began; -1 before the first step
    station: float  # of the guided point along the path [m]
    pace: DriverMemory  # of the driver who keeps the speed


class FmuDriver(FmuPart, DriverLike[FmuDriverMemory]):
    """A driver that is an FMU; who keeps the set speed where it does not."""

    def __init__(self, context: DriverContext) -> None:
        self._course, self._speed = context.course, context.speed
        self._pace = PreviewDriver(context.tractor, context.course.path, context.speed)
        self._start("driver.parameters", driver_signals(len(context.vehicle.units)), context.parameters)
        self._command = DriverCommand(0.0, 0.0)

    def init(self) -> FmuDriverMemory:
        """Memory before the first step."""
        return FmuDriverMemory(-1, 0.0, self._pace.init())

    def step(self, memory: FmuDriverMemory, tick: int, ego: EgoState, /) -> tuple[FmuDriverMemory, DriverCommand]:
        """Command at ``tick``.

        Raises:
            FmuError: if the FMU fails, stalls, crashes or gives no finite number.
        """
        instance = self._instance
        if memory.start < 0 and instance.ticks > 0:
            instance.restart()
        start = tick if memory.start < 0 else memory.start
        pace, keeping = self._pace.step(memory.pace, tick, ego)
        if instance.ticks > tick - start:
            return FmuDriverMemory(start, memory.station, pace), self._command
        station, signals = self._signals(memory.station, tick, ego)
        found = instance.until(tick - start, signals)
        acceleration = found.get("acceleration", keeping.acceleration)
        self._command = DriverCommand(found["steer"], acceleration, found.get("gear", 1.0))
        return FmuDriverMemory(start, station, pace), self._command

    def _signals(self, near: float, tick: int, ego: EgoState) -> tuple[float, dict[str, float]]:
        """Station of the guided point, and the inputs [SI] of the FMU."""
        path = self._course.path
        station, signals = driver_inputs(self._course, self._speed, near, tick, ego)
        wanted = {int(name.rpartition("_")[2]) for name in self._instance.used if name.startswith("ahead_")}
        for k in wanted:
            place = path.pose(station + k)
            dx, dy = place.x - ego.x, place.y - ego.y
            signals[f"ahead_x_{k}"] = math.cos(ego.psi) * dx + math.sin(ego.psi) * dy
            signals[f"ahead_y_{k}"] = math.cos(ego.psi) * dy - math.sin(ego.psi) * dx
        return station, signals

    def __deepcopy__(self, memo: dict[int, Any]) -> "FmuDriver":
        other = copy.copy(self)
        other._instance = copy.deepcopy(self._instance, memo)
        return other


def driver_inputs(
    course: Course, speed: float, near: float, tick: int, ego: EgoState
) -> tuple[float, dict[str, float]]:
    """Station of the guided point, ``near`` the last one [m], and inputs [SI] of a driver but for the path ahead."""
    path, pose = course.path, Pose2(ego.x, ego.y, ego.psi)
    guided = pose @ Pose2(*course.reference, 0.0)
    station = path.project(guided.x, guided.y, near)
    on_path = path.pose(station)
    left = math.cos(on_path.psi) * (guided.y - on_path.y) - math.sin(on_path.psi) * (guided.x - on_path.x)
    signals = {
        "time": tick * TICK,
        "set_speed": speed,
        **{signal.name: getattr(ego, signal.name) for signal in numbered_signals.MOTION},
        "station": station,
        "lateral_error": left,
        "heading_error": math.remainder(ego.psi - on_path.psi, math.tau),
        "curvature": path.curvature(station),
    }
    return station, signals | numbered_signals.numbered_values("articulation", ego.articulation)


_PERIOD = 10  # of the loop [ticks]
_REQUIRED = ("off_tracking", "off_tracking_known")


def off_tracking_signals(vehicle: Vehicle) -> PartSignals:
    """Signals of a source of off-tracking on a vehicle."""
    given = (*numbered_signals.estimate_signals(coarse=False), Signal("off_tracking_count", "-", "estimates so far"))
    return PartSignals(
        kind="off_tracking",
        inputs=(Signal("time", "s", "since the start"), *numbered_signals.truth_signals(vehicle)),
        outputs=tuple(one._replace(required=one.name in _REQUIRED) for one in given),
    )


class WholeMotion:
    """Sensor that passes on the motion of the combination at every step of the loop."""

    sends: ClassVar = Truth

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """The sensor, without latency: that of the estimates is the FMU's own."""
        return OpenedSensor(sensor=cls(), schedule=Schedule(period=_PERIOD))

    def sample(self, truth: Truth) -> Truth:
        """The truth itself."""
        return truth


class FmuOffTracking(FmuPart):
    """A source of off-tracking that is an FMU; its memory is the number of estimates so far."""

    sensor: ClassVar[str] = "offtrack.exchange.fmi_import.fmu_parts:WholeMotion"

    def __init__(self, context: TrailerContext) -> None:
        self._start("estimator", off_tracking_signals(context.vehicle), context.options)
        self._unknown = dict.fromkeys((one.name for one in numbered_signals.estimate_signals(coarse=False)), 0.0)
        self._unknown["off_tracking_time"] = -1.0

    def init(self) -> float:
        """Memory before the first step."""
        return 0.0

    def step(self, memory: float, message: Truth) -> tuple[float, OffTracking | None]:
        """Number of estimates so far, and the newest one if it is new.

        Raises:
            FmuError: if the FMU fails, stalls, crashes or gives no finite number.
        """
        found = self._instance.until(
            message.tick, {"time": message.tick * TICK, **numbered_signals.truth_values(message)}
        )
        if not found:
            return memory, None
        estimate = numbered_signals.estimate_of(message.tick, {**self._unknown, **found})
        count = found.get("off_tracking_count", memory + 1.0)  # without it every step gives a new one
        return count, estimate if count > memory else None


law_of, driver_of, off_tracking_of = FmuLaw.of_file, FmuDriver.of_file, FmuOffTracking.of_file  # entry points


def signals_of(part: str, vehicle: Vehicle) -> PartSignals:
    """Signals of a trailer steering law, a source of off-tracking, a driver or a plant for a vehicle.

    Raises:
        ValueError: one line, for a law where no trailer axle is steered.
    """
    if part == "driver":
        return driver_signals(len(vehicle.units))
    if part == "off_tracking":
        return off_tracking_signals(vehicle)
    if part == "plant":
        return plant_signals(vehicle)
    return law_signals(len(vehicle.units[steered_unit(vehicle)].steered_axles), len(vehicle.units))


def steered_unit(vehicle: Vehicle) -> int:
    """Index of the last trailer with steered axles.

    Raises:
        ValueError: one line, if there is none.
    """
    steered = [unit for unit, one in enumerate(vehicle.units) if unit > 0 and one.steered_axles]
    if not steered:
        raise ValueError(f"vehicle {vehicle.name}: no axle of a trailer is steered; choose another --vehicle")
    return steered[-1]
