"""What a run leaves behind: its result in memory, its summary, and the run directory on disk.

A run directory holds ``scenario.toml`` (runs again identically), ``manifest.json`` (versions, seed, hashes),
``signals.parquet`` (SI, units in the schema), ``summary.json``, ``report.html`` and a video. It appears complete or
not at all: everything is written beside it and moved into place at the end.
"""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
import platform
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from scenarios.results import metrics
from scenarios.results.log import LOST, Log, write_log
from scenarios.results.swept_path import SweptPath, swept_path
from scenarios.results.swept_path import (
    UnitOutline as UnitOutline,  # part of this module's words: a RunResult is built from it
)
from vehicle.frames import FloatArray

Numbers = dict[str, float | int | None]
Summary = dict[str, str | int | Numbers | dict[str, Numbers]]
Progress = Callable[[int, int], None]  # done so far, of how many


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Where the time of a run went [s]."""

    simulated_s: float
    wall_s: float
    physics_s: float
    render_s: float
    odometry_s: float
    odometry_beside_s: float = 0.0  # of it, what ran beside the other stages and cost no wall time

    @property
    def rest_s(self) -> float:
        """Wall time outside the three stages: controllers, bookkeeping, log [s]."""
        waited = self.odometry_s - self.odometry_beside_s
        return max(0.0, self.wall_s - self.physics_s - self.render_s - waited)

    @property
    def realtime_factor(self) -> float:
        """Simulated time over wall time: above 1 the run was faster than reality."""
        return self.simulated_s / self.wall_s if self.wall_s > 0.0 else math.nan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFrame:
    """What the left camera saw, kept for people: the odometry itself worked on the uncompressed images."""

    tick: int
    jpeg: bytes  # colour or grey
    tracks: NDArray[np.float32]  # (m, 4) u, v in the previous and u, v in this left image [px]
    matches: int
    inliers: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TrailerAhead:
    """A trailer in front of the last that is watched, too; its signals end with its name."""

    name: str
    follow_distance: float  # hitch to follow point [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunResult:
    """Everything a finished run has to tell."""

    scenario: str  # name
    scenario_toml: str  # resolved: runs again identically
    seed: int
    outcome: str  # "completed", "diverged", …
    log: Log
    units: tuple[UnitOutline, ...]  # tractor first; the last one is the trailer that is steered and judged
    follow_distance: float  # hitch to follow point of that trailer [m]
    road: FloatArray  # (n, 2) centre line [m]
    road_half_width: float  # [m]
    circle_centre: tuple[float, float] | None  # of the course, if it is a roundabout [m]
    timing: Timing
    frames: tuple[CameraFrame, ...]  # empty without cameras
    manifest: Mapping[str, str]  # what only the run knows: OpenGL renderer, hash of the sensor images, …
    trailer_steer_limit: float | None = None  # for the plots [rad]; None where the trailer is not steered
    trailers_ahead: tuple[TrailerAhead, ...] = ()  # front to rear

    @property
    def trailer(self) -> UnitOutline:
        """The trailer whose rear is to follow its hitch."""
        return self.units[-1]

    def poses(self, unit: UnitOutline) -> FloatArray:
        """x [m], y [m], psi [rad] of the unit's frame over time, shape (n_rows, 3)."""
        return np.column_stack([self.log[f"{quantity}_{unit.name}"] for quantity in ("x", "y", "psi")])

    def signal(self, name: str) -> FloatArray:
        """The signal over time, shape (n_rows,); NaN throughout if this run has none of that name."""
        return self.log[name] if name in self.log else np.full(len(self.log), np.nan)

    def steer_signals(self, ahead: str = "") -> tuple[str, ...]:
        """Names of the signals that hold the last trailer's steer angles, or those of one ``ahead``, front to rear.

        Demands have ``_command`` added after the axle's number.
        """
        ending = f"_{ahead}" if ahead else ""
        own = (name.removesuffix(ending) for name in self.log.names if name.endswith(ending))
        return tuple(f"{name}{ending}" for name in own if name.removeprefix("steer_trailer_").isdigit())

    def axle_steer(self, unit: UnitOutline) -> FloatArray:
        """Steer of each axle of a unit over time, shape (n_rows, n_axles) [rad], for drawings.

        The log does not say which axles are steered: the tractor's foremost, and a trailer's rearmost ones are.
        """
        steer = np.zeros((len(self.log), len(unit.axles)))
        if unit is self.units[0] and unit.axles:
            steer[:, int(np.argmax(unit.axles))] = self.signal("steer_tractor")
        else:
            names = self.steer_signals("" if unit is self.trailer else unit.name)[-len(unit.axles) :]
            order = np.argsort(unit.axles)[: len(names)][::-1]  # rearmost axles, front to rear
            for axle, name in zip(order, names, strict=True):
                steer[:, axle] = self.log[name]
        return np.nan_to_num(steer)


def summary(result: RunResult) -> Summary:
    """The run in numbers, ready for JSON: null stands for what does not apply or could not be measured.

    Names, and the units in them, are fixed; users and checks rely on them.
    """
    worst, of_each = _worst(result), trailer_summaries(result)
    return {
        "outcome": result.outcome,
        "scenario": result.scenario,
        "seed": result.seed,
        "off_tracking": _off_tracking(result, worst),
        "swept_path": _swept_path(swept(result)),
        "steer": _steer(result, worst),
        "tyres": {"friction_used_max": number(metrics.peak(result.signal("friction_used_max")))},
        "odometry": _odometry(result),
        "timing": _timing(result.timing),
        **({"trailers": of_each} if of_each else {}),
    }


def trailer_summaries(result: RunResult) -> dict[str, Numbers]:
    """Off-tracking and steering of every watched trailer by its name, front to rear; of one alone nothing."""
    if not result.trailers_ahead:
        return {}
    names = [(trailer.name, trailer.name) for trailer in result.trailers_ahead] + [(result.trailer.name, "")]
    return {
        name: _off_tracking(result, ahead) | {f"steer_{key}": value for key, value in _steer(result, ahead).items()}
        for name, ahead in names
    }


def _worst(result: RunResult) -> str:
    """The trailer ahead with the largest off-tracking, or nothing if it is the last one's."""
    largest = {"": metrics.peak(result.signal("off_tracking_true"))}
    for trailer in result.trailers_ahead:
        largest[trailer.name] = metrics.peak(result.signal(f"off_tracking_true_{trailer.name}"))
    return max(largest, key=lambda name: np.nan_to_num(largest[name]))


def swept(result: RunResult) -> SweptPath:
    """The room the run took; NaN throughout if it ended before the vehicle had moved."""
    if len(result.log) < 2:
        return SweptPath(math.nan, math.nan, math.nan, math.nan, math.nan)
    return swept_path(result.units, tuple(result.poses(unit) for unit in result.units), result.circle_centre)


def error_of_estimate(result: RunResult, ahead: str = "") -> FloatArray:
    """Estimated minus true off-tracking at the estimate's own time [m], shape (n_rows,); NaN where there is none.

    Of the last trailer, or of one ``ahead``.
    """
    ending = f"_{ahead}" if ahead else ""
    estimate, true, health = (
        result.signal(f"{name}{ending}") for name in ("off_tracking_estimate", "off_tracking_true", "health")
    )
    return metrics.estimate_error(estimate, true, health)


def _off_tracking(result: RunResult, ahead: str) -> Numbers:
    ending = f"_{ahead}" if ahead else ""
    true, error = result.signal(f"off_tracking_true{ending}"), error_of_estimate(result, ahead)
    reference = result.signal(f"off_tracking_reference{ending}")
    return {
        "true_rms_m": number(metrics.rms(true)),
        "true_max_m": number(metrics.peak(true)),
        "estimate_error_rms_m": number(metrics.rms(error)),
        "estimate_error_max_m": number(metrics.peak(error)),
        "valid_fraction": number(metrics.valid_fraction(result.signal(f"health{ending}"), true)),
        "reference_error_rms_m": number(metrics.rms(reference - true)),
        "estimate_against_reference_rms_m": number(metrics.rms(error + true - reference)),
    }


def _swept_path(room: SweptPath) -> Numbers:
    return {
        "max_width_m": number(room.max_width),
        "min_inner_radius_m": number(room.min_inner_radius),
        "tail_swing_m": number(room.tail_swing),
        "tail_swing_entry_m": number(room.tail_swing_entry),
        "tail_swing_exit_m": number(room.tail_swing_exit),
    }


def _steer(result: RunResult, ahead: str) -> Numbers:
    angles = [result.log[name] for name in result.steer_signals(ahead)]
    largest = max((metrics.peak(angle) for angle in angles), default=math.nan)
    fastest = max((metrics.peak(metrics.rate(angle, result.log["time"])) for angle in angles), default=math.nan)
    return {"max_deg": number(math.degrees(largest)), "max_rate_deg_s": number(math.degrees(fastest))}


def _odometry(result: RunResult) -> Numbers:
    health = result.signal("odometry_health")
    captures = np.isfinite(health)
    drift = metrics.odometry_drift(
        result.poses(result.trailer)[captures],
        np.column_stack([result.signal(f"odometry_{part}")[captures] for part in ("dx", "dy", "dpsi")]),
        health[captures] >= LOST,
        result.follow_distance,
    )
    return {
        "matches_mean": number(metrics.mean(result.signal("matches"))),
        "inliers_mean": number(metrics.mean(result.signal("inliers"))),
        "lost_frames": int(np.sum(health[captures] >= LOST)) if captures.any() else None,
        "drift_percent": number(100.0 * metrics.mean(drift)),
    }


def _timing(timing: Timing) -> Numbers:
    names = ("simulated_s", "wall_s", "realtime_factor", "physics_s", "render_s", "odometry_s")
    return {name: number(getattr(timing, name)) for name in names}


def number(value: float) -> float | None:
    """The value to the last micrometre, or None where there is no number."""
    return round(float(value), 6) if math.isfinite(value) else None


def versions() -> dict[str, str]:
    """Versions of what a run's numbers depend on."""
    installed = {name: importlib.metadata.version(name) for name in ("offtrack", "numpy", "casadi")}
    return {"python": platform.python_version(), **installed, "opencv": cv2.__version__}


def next_run_directory(scenario: str, root: Path = Path("runs")) -> Path:
    """The first free ``runs/<scenario>-<n>``, n counted from 1 and beyond every run there is."""
    taken = [path.name.removeprefix(f"{scenario}-") for path in root.glob(f"{scenario}-*")]
    return root / f"{scenario}-{1 + max((int(n) for n in taken if n.isdigit()), default=0)}"


def check_run_directory(directory: Path) -> None:
    """Refuses a directory in which :func:`write_run` could not put a complete run; call it before a long one.

    Raises:
        ValueError: if it is a file, holds something already, can not be replaced, or can not be made.
    """
    if directory.exists() and not directory.is_dir():
        raise ValueError(f"{directory} is a file: choose another name")
    if directory.is_dir() and any(directory.iterdir()):
        raise ValueError(f"directory {directory} is not empty: choose another, or remove it first")
    if directory.is_dir() and (directory.is_mount() or directory.resolve() == Path.cwd()):
        raise ValueError(f"directory {directory} can not be replaced as a whole: name a new folder inside it")
    parent = next(path for path in directory.resolve().parents if path.exists())
    if not (parent.is_dir() and os.access(parent, os.W_OK)):
        raise ValueError(f"directory {directory} can not be made: no permission to write in {parent}")


@contextmanager
def appearing_at_once(directory: Path) -> Iterator[Path]:
    """A hidden folder beside ``directory`` to write into; it takes that name if all goes well, else it is removed."""
    check_run_directory(directory)
    directory = directory.resolve()
    directory.parent.mkdir(parents=True, exist_ok=True)
    unfinished = directory.with_name(f".{directory.name}.{os.getpid()}.unfinished")
    unfinished.mkdir()
    try:
        yield unfinished
        unfinished.rename(directory)  # replaces an empty directory, refuses one that has been filled meanwhile
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def write_run(result: RunResult, directory: Path, *, video: bool = True, progress: Progress | None = None) -> Path:
    """Writes the run directory and returns it; ``progress`` is told the frames of the video.

    Raises:
        ValueError: if the directory can not take a run, see :func:`check_run_directory`.
    """
    from scenarios.report.run_page import (
        report_html,  # matplotlib takes a second to import, and a run that fails needs none
    )
    from scenarios.report.run_video import write_video

    numbers = summary(result)
    moves = video and len(result.log) > 1
    return write_files(
        directory,
        scenario_toml=result.scenario_toml,
        log=result.log,
        manifest=manifest(result),
        report=report_html(result, numbers),
        numbers=numbers,
        video=(lambda path: write_video(result, path, progress=progress)) if moves else None,
    )


def write_files(
    directory: Path,
    *,
    scenario_toml: str,
    log: Log,
    manifest: Mapping[str, object],
    report: str,
    numbers: Summary,
    video: Callable[[Path], Path] | None,
) -> Path:
    """Writes what every run leaves, a trailer's or a rover's, and returns the directory; ``video``: its writer."""
    with appearing_at_once(directory) as folder:
        (folder / "scenario.toml").write_text(scenario_toml, encoding="utf-8")
        write_log(log, folder / "signals.parquet")
        _write_json(folder / "manifest.json", manifest)
        (folder / "report.html").write_text(report, encoding="utf-8")
        if video:
            video(folder / "video")
        _write_json(folder / "summary.json", numbers)
    return directory


def manifest(result: RunResult) -> dict[str, object]:
    """What identifies the run: where its numbers come from, and hashes to compare them by."""
    return {
        "scenario": result.scenario,
        "seed": result.seed,
        "versions": versions(),
        "signals_sha256": result.log.sha256(),
        **result.manifest,
    }


def _write_json(path: Path, content: Mapping[str, object]) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
