"""The drive of a finished run, from its run directory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.assembly.adapters import course_of, outlines, vehicle_of
from scenarios.assembly.plants import plant_vehicle
from scenarios.drawings.content import DrivenPath
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.results.log import Log, read_log
from scenarios.results.swept_path import UnitOutline
from vehicle.frames import FloatArray
from vehicle.user_file import FileKind, read_text, shown


def driven_run(directory: Path) -> DrivenPath:
    """The drive of a trailer's run.

    Raises:
        ValueError: one line, if this is no run directory of a trailer, or its files can not be read.
    """
    if not (directory / "scenario.toml").is_file():
        raise ValueError(f"{shown(str(directory))}: is no run directory: it has no scenario.toml")
    scenario = load_any_scenario(str(directory / "scenario.toml"))
    if not isinstance(scenario, Scenario):
        raise ValueError(f"{shown(str(directory))}: is a rover's run: only runs of trailers are drawn")
    nominal = vehicle_of(scenario)
    vehicle, course = plant_vehicle(scenario, nominal), course_of(scenario, nominal)
    log, units = read_log(directory / "signals.parquet"), outlines(vehicle)
    needed = ("time", *(name for unit in units for name in pose_signals(unit)))
    missing = [name for name in needed if name not in log]
    if missing:
        raise ValueError(f"{directory / 'signals.parquet'}: has no signal {shown(missing[0])}")
    outcome, seed = (_told(directory / "summary.json", key) for key in ("outcome", "seed"))
    return DrivenPath(
        title=f"{scenario.name}: {vehicle.name}",
        notes=(f"outcome: {outcome}, seed {seed}, {scenario.speed_kmh:g} km/h",),
        units=units,
        poses=tuple(unit_poses(log, unit) for unit in units),
        steer=tuple(axle_steer(log, unit) for unit in units),
        time=log["time"],
        front_axle_x=vehicle.units[0].steered_axles[0].x,
        course=course.path.points(0.25),
        road=course.centreline,
        road_half_width=course.road_half_width,
    )


def pose_signals(unit: UnitOutline) -> tuple[str, ...]:
    """Names of the signals of a unit's pose."""
    return tuple(f"{quantity}_{unit.name}" for quantity in ("x", "y", "psi"))


def unit_poses(log: Log, unit: UnitOutline) -> FloatArray:
    """x [m], y [m], psi [rad] of a unit over time, (n, 3)."""
    return np.column_stack([log[name] for name in pose_signals(unit)])


def axle_steer(log: Log, unit: UnitOutline) -> FloatArray:
    """Steer angle of each axle of a unit over time, (n, n_axles) [rad]; zero where the log has none."""
    zero = np.zeros(len(log))
    angles = [log[name] if name and name in log else zero for name in unit.steer_signals]
    return np.nan_to_num(np.column_stack(angles))


def _told(path: Path, key: str) -> Any:
    """An entry of a run's summary; a dash if there is none."""
    try:
        return json.loads(read_text(path, FileKind.RECORD)).get(key, "–")
    except (ValueError, AttributeError):
        return "–"
