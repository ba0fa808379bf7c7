"""FMUs as drivers of the tractor."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

from controllers.driver import DriverCommand, DriverLike, DriverMemory, PreviewDriver
from scenarios.fmi_import.archive import FmuFile, open_fmu
from scenarios.fmi_import.instance import FmuInstance
from scenarios.fmi_import.mapping import PartSignals, Signal, read_map
from scenarios.fmi_import.parameters import options_of
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.frames import Pose2
from vehicle.option import Option, check_options

if TYPE_CHECKING:
    from scenarios.assembly.drivers import DriverContext
    from scenarios.courses import Course

_AHEAD: Final = 60  # points of the path that an FMU can take, a metre apart


def driver_signals(n_units: int) -> PartSignals:
    """Signals of a driver of a combination of ``n_units``."""
    points, hitches = range(_AHEAD + 1), range(1, n_units)
    return PartSignals(
        kind="driver",
        inputs=(
            Signal("time", "s", "since the start"),
            Signal("set_speed", "m/s", "speed that the scenario asks for"),
            Signal("x", "m", "position of the tractor's rear axle"),
            Signal("y", "m", "position of the tractor's rear axle"),
            Signal("psi", "rad", "heading of the tractor, + left"),
            Signal("v_x", "m/s", "velocity of its rear axle along its x axis"),
            Signal("v_y", "m/s", "along its y axis"),
            Signal("yaw_rate", "rad/s", "of the tractor, + left"),
            *(Signal(f"articulation_{k}", "rad", f"at hitch {k}: unit ahead minus unit behind") for k in hitches),
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


class FmuDriver(DriverLike[FmuDriverMemory]):
    """A driver that is an FMU; who keeps the set speed where it does not."""

    fmu: ClassVar[FmuFile]
    options: ClassVar[tuple[Option, ...]] = ()

    @classmethod
    def of(cls, context: DriverContext) -> FmuDriver:
        """Driver for the course of a run.

        Raises:
            ValueError: one line, if the map does not fit or the FMU can't be started.
        """
        return cls(context)

    def __init__(self, context: DriverContext) -> None:
        check_options(self.options, context.parameters, "driver.parameters")
        links = read_map(self.fmu, driver_signals(len(context.vehicle.units)))
        given = {name: float(value) for name, value in context.parameters.items()}
        self._course, self._speed = context.course, context.speed
        self._pace = PreviewDriver(context.tractor, context.course.path, context.speed)
        self._instance = FmuInstance(self.fmu, links, given)
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
        found: dict[str, float] = {}
        while instance.ticks <= tick - start:
            found = instance.step(instance.period, signals)
        acceleration = found.get("acceleration", keeping.acceleration)
        self._command = DriverCommand(found["steer"], acceleration, found.get("gear", 1.0))
        return FmuDriverMemory(start, station, pace), self._command

    def close(self) -> None:
        """End the FMU's process."""
        self._instance.close()

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

    def __deepcopy__(self, memo: dict[int, Any]) -> FmuDriver:
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
        "x": ego.x,
        "y": ego.y,
        "psi": ego.psi,
        "v_x": ego.v_x,
        "v_y": ego.v_y,
        "yaw_rate": ego.yaw_rate,
        "station": station,
        "lateral_error": left,
        "heading_error": math.remainder(ego.psi - on_path.psi, math.tau),
        "curvature": path.curvature(station),
    }
    return station, signals | {f"articulation_{k}": angle for k, angle in enumerate(ego.articulation, start=1)}


def driver_of(file: str) -> type[FmuDriver]:
    """Class of the driver of an FMU.

    Raises:
        ValueError: one line, if it is no FMU that runs here.
    """
    fmu = open_fmu(Path(file))
    return type("FmuDriver", (FmuDriver,), {"fmu": fmu, "options": options_of(fmu)})
