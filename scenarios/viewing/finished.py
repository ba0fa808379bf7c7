"""Results of finished runs, rebuilt from scenario, signals and summary; without pictures, which only pages hold."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.assembly.adapters import course_of, outlines, vehicle_of
from scenarios.assembly.ground_friction import ground_friction
from scenarios.assembly.plants import plant_vehicle
from scenarios.assembly.rover import rover_path
from scenarios.options.rover import RoverScenario
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.player.playback import Picture
from scenarios.results.friction_picture import friction_picture
from scenarios.results.log import Log, read_log
from scenarios.results.rover import RoverResult
from scenarios.results.run_result import JudgedTrailer, RunResult
from scenarios.results.timing import Timing
from scenarios.viewing.page_pictures import pictures_of_page
from sensors.sand.rig import nominal_rig
from vehicle.combination.description import Vehicle
from vehicle.rover.description import load_rover
from vehicle.surface import Surface
from vehicle.user_file import FileKind, read_text, shown

_SPACING = 0.02  # of points on a rover's path [m]
_NEEDED = ("summary.json", "scenario.toml", "signals.parquet")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FinishedRun:
    """A finished run as its directory tells it."""

    name: str
    directory: Path
    summary: Mapping[str, Any]
    result: RunResult | RoverResult
    pictures: tuple[Picture, ...] = ()  # those of its page

    @property
    def is_rover(self) -> bool:
        """True for a rover's run."""
        return isinstance(self.result, RoverResult)


def finished_run(directory: Path, name: str) -> FinishedRun:
    """The run of a directory.

    Raises:
        ValueError: one line, if it holds no finished run, or its files do not fit each other.
    """
    for file in _NEEDED:
        if not (directory / file).is_file():
            raise ValueError(f"{shown(str(directory))}: is no finished run: it has no {file}")
    text = read_text(directory / "summary.json", FileKind.RECORD)
    try:
        summary = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{directory / 'summary.json'}: not JSON: {error.msg}") from None
    if not isinstance(summary, dict) or "outcome" not in summary:
        raise ValueError(f"{directory / 'summary.json'}: is no summary of a run")
    scenario = load_any_scenario(str(directory / "scenario.toml"))
    log = read_log(directory / "signals.parquet")
    return FinishedRun(
        name=name,
        directory=directory,
        summary=summary,
        result=rebuilt(scenario, log, summary),
        pictures=pictures_of_page(directory / "report.html"),
    )


def rebuilt(scenario: Scenario | RoverScenario, log: Log, summary: Mapping[str, Any]) -> RunResult | RoverResult:
    """The result of a run from its scenario, signals and summary.

    Raises:
        ValueError: one line, if the signals are not those of this scenario.
    """
    if isinstance(scenario, RoverScenario):
        return _rover(scenario, log, summary)
    return _trailer(scenario, log, summary)


def _trailer(scenario: Scenario, log: Log, summary: Mapping[str, Any]) -> RunResult:
    nominal = vehicle_of(scenario)
    vehicle, course = plant_vehicle(scenario, nominal), course_of(scenario, nominal)
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


def _judged(vehicle: Vehicle, log: Log) -> tuple[JudgedTrailer, ...]:
    """The trailers with an off-tracking in the log; the last in any case."""
    trailers = []
    for unit in vehicle.units[1:]:
        if f"off_tracking_true_{unit.name}" not in log and unit is not vehicle.units[-1]:
            continue
        steered = sum(f"steer_trailer_{k}_command_{unit.name}" in log for k in range(1, len(unit.axles) + 1))
        trailers.append(
            JudgedTrailer(name=unit.name, follow_distance=-(unit.follow_x or 0.0), n_steered=steered, max_steer=None)
        )
    return tuple(trailers)


def _rover(scenario: RoverScenario, log: Log, summary: Mapping[str, Any]) -> RoverResult:
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
