"""What reports need of each kind of vehicle: page, video, playback, and the result of a run from its files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from offtrack.reports.player.playback import Playback, PlayedRun
from offtrack.reports.player.run_playback import played_rover, played_trailer, rover_playback, trailer_playback
from scenarios.assembly.adapters import course_of, ground_friction, outlines, plant_vehicle, vehicle_of
from scenarios.assembly.rover_run import rover_path
from scenarios.options.scenario import RoverScenario, Scenario
from scenarios.progress import Progress
from scenarios.results.log import Log
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_summary import Result, Summary, Timing
from scenarios.results.trailer_result import JudgedTrailer, RunResult, friction_picture
from sensors.sand.trace_rig import nominal_rig
from vehicle.combination.description import Vehicle
from vehicle.foundation.user_file import shown
from vehicle.rover.description import load_rover
from vehicle.surface import Surface

_SPACING: Final = 0.02  # of points on a rover's path [m]


class Kind(Protocol):
    """How runs of a kind of vehicle are reported; results and scenarios are those of this kind."""

    def html(self, result: Any, numbers: Summary) -> str:
        """The page of a run."""

    def write_video(self, result: Any, path: Path, progress: Progress) -> None:
        """Write the video of a run; ``path`` has no suffix."""

    def playback(self, result: Any) -> Playback:
        """Everything that a page shows of a run over time."""

    def played(self, result: Any, name: str) -> PlayedRun:
        """The run alone, under a name, to be laid over others."""

    def rebuilt(self, scenario: Any, log: Log, summary: Mapping[str, Any]) -> Result:
        """The result of a run from its scenario, signals and summary.

        Raises:
            ValueError: one line, if the signals are not those of this scenario.
        """


class _Combinations:
    """Pages of combinations; matplotlib takes a second to import, and a run that fails needs none."""

    def html(self, result: RunResult, numbers: Summary) -> str:
        from offtrack.reports.run_page import report_html

        return report_html(result, numbers)

    def write_video(self, result: RunResult, path: Path, progress: Progress) -> None:
        from offtrack.reports.run_video import write_video

        write_video(result, path, progress=progress)

    def playback(self, result: RunResult) -> Playback:
        return trailer_playback(result)

    def played(self, result: RunResult, name: str) -> PlayedRun:
        return played_trailer(result, name)

    def rebuilt(self, scenario: Scenario, log: Log, summary: Mapping[str, Any]) -> RunResult:
        nominal = vehicle_of(scenario)
        vehicle, course = plant_vehicle(scenario), course_of(scenario, nominal)
        units = outlines(vehicle)
        _check(log, ["time", *(f"{quantity}_{unit.name}" for unit in units for quantity in ("x", "y", "psi"))])
        surface = Surface(friction=ground_friction(scenario.surface, course.centreline, course.friction))
        return RunResult(
            scenario=scenario.name,
            scenario_toml=scenario.to_toml(),
            seed=int(summary.get("seed", 0)),
            outcome=str(summary["outcome"]),
            log=log,
            units=units,
            trailers=_judged(vehicle, log),
            road=course.centreline,
            road_half_width=course.road_half_width,
            friction=friction_picture(surface, course.centreline),
            circle_centre=course.surface_centre,
            arcs=course.arcs,
            path_deviation=course.deviation,
            timing=_timing(summary),
            frames=(),
            manifest={},
        )


class _Rovers:
    """Pages of rovers."""

    def html(self, result: RoverResult, numbers: Summary) -> str:
        from offtrack.reports.rover_report import rover_report_html

        return rover_report_html(result, numbers)

    def write_video(self, result: RoverResult, path: Path, progress: Progress) -> None:
        from offtrack.reports.rover_report import write_rover_video

        write_rover_video(result, path, progress=progress)

    def playback(self, result: RoverResult) -> Playback:
        return rover_playback(result)

    def played(self, result: RoverResult, name: str) -> PlayedRun:
        return played_rover(result, name)

    def rebuilt(self, scenario: RoverScenario, log: Log, summary: Mapping[str, Any]) -> RoverResult:
        rover = load_rover(scenario.vehicle)
        _check(log, ["time", "x", "y", "psi", "slip_angle_true", "x_wheels", "x_corrected"])
        return RoverResult(
            scenario=scenario.name,
            scenario_toml=scenario.to_toml(),
            seed=int(summary.get("seed", 0)),
            outcome=str(summary["outcome"]),
            log=log,
            rover=rover.name,
            path=rover_path(scenario).points(_SPACING),
            rig=nominal_rig(rover),
            timing=_timing(summary),
            frames=(),
            manifest={},
        )


KINDS: Final[Mapping[str, Kind]] = {"trailer": _Combinations(), "rover": _Rovers()}  # by a result's ``kind``


def _judged(vehicle: Vehicle, log: Log) -> tuple[JudgedTrailer, ...]:
    """The trailers with an off-tracking in the log; the last in any case."""
    trailers = []
    for k in range(min(1, len(vehicle.units) - 1), len(vehicle.units)):
        unit = vehicle.led_unit(k)
        if f"off_tracking_true_{unit.name}" not in log and k < len(vehicle.units) - 1:
            continue
        steered = sum(f"steer_trailer_{k}_command_{unit.name}" in log for k in range(1, len(unit.axles) + 1))
        trailers.append(
            JudgedTrailer(name=unit.name, follow_distance=-(unit.follow_x or 0.0), n_steered=steered, max_steer=None)
        )
    return tuple(trailers)


def _check(log: Log, needed: list[str]) -> None:
    missing = [name for name in needed if name not in log]
    if missing or not len(log) or not np.isfinite(log["time"]).all():
        what = f"has no signal {shown(missing[0])}" if missing else "has no rows"
        raise ValueError(f"signals.parquet: {what}, so it is not of this scenario")


def _timing(summary: Mapping[str, Any]) -> Timing:
    numbers = summary.get("timing")
    known = numbers if isinstance(numbers, Mapping) else {}
    names = ("simulated_s", "wall_s", "physics_s", "render_s", "odometry_s")
    return Timing(**{name: float(value) if (value := known.get(name)) is not None else math.nan for name in names})
