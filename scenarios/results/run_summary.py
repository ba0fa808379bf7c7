"""Summary of a run, whose names and units are fixed, and the manifest that identifies the run."""

from __future__ import annotations

import importlib.metadata
import math
import platform

import cv2
import numpy as np

from scenarios.results import metrics
from scenarios.results.log import LOST, OK
from scenarios.results.rover_result import RoverResult, rover_summary
from scenarios.results.run_inputs import manifest_entry
from scenarios.results.summary_numbers import Numbers, Summary, number, timing_numbers
from scenarios.results.swept_path import RoadEdges, SweptPath, swept_path, wheel_clearance
from scenarios.results.trailer_result import JudgedTrailer, RunResult, error_of_estimate
from vehicle.engine.compiler import engine_name
from vehicle.frames import FloatArray


def summary(result: RunResult | RoverResult) -> Summary:
    """The run in numbers, ready for JSON: null stands for numbers that do not apply or were not measured."""
    return rover_summary(result) if isinstance(result, RoverResult) else _trailer_summary(result)


def _trailer_summary(result: RunResult) -> Summary:
    worst = _worst(result).name
    numbers: Summary = {
        "outcome": result.outcome,
        "scenario": result.scenario,
        "seed": result.seed,
        "warnings": list(all_warnings(result)),
        "off_tracking": _off_tracking(result, worst),
        "swept_path": _swept_path(swept(result)),
        "road": _road(result),
        "steer": _steer(result, worst),
        "tyres": {"friction_used_max": number(metrics.peak(result.signal("friction_used_max")))},
        "odometry": _odometry(result),
        "timing": timing_numbers(result.timing),
    }
    if result.paced is not None:
        numbers["paced"] = result.paced.numbers()
    if result.outside is not None:
        numbers["outside"] = result.outside.numbers()
    if result.path_deviation is not None:
        numbers["course"] = {"path_deviation_m": number(result.path_deviation)}
    return numbers | ({"trailers": trailer_summaries(result)} if len(result.trailers) > 1 else {})


def all_warnings(result: RunResult) -> tuple[str, ...]:
    """Lines about what is doubtful: of the run itself, of its pace, and of what came from outside."""
    of_times = result.paced.warnings if result.paced else ()
    return (*result.warnings, *of_times, *(result.outside.warnings if result.outside else ()))


def trailer_summaries(result: RunResult) -> dict[str, Numbers]:
    """Off-tracking and steering of every judged trailer by its name, front to rear."""
    return {
        trailer.name: _off_tracking(result, trailer.name)
        | {f"steer_{key}": value for key, value in _steer(result, trailer.name).items()}
        for trailer in result.trailers
    }


def _worst(result: RunResult) -> JudgedTrailer:
    """The trailer with the largest off-tracking; of equal ones the last."""
    peaks = [np.nan_to_num(metrics.peak(result.signal(f"off_tracking_true_{t.name}"))) for t in result.trailers]
    return result.trailers[len(peaks) - 1 - int(np.argmax(peaks[::-1]))]


def swept(result: RunResult) -> SweptPath:
    """Swept path of the run; NaN throughout if it ended before the vehicle had moved."""
    if len(result.log) < 2:
        return SweptPath(math.nan, math.nan, math.nan, math.nan, math.nan)
    return swept_path(
        result.units, tuple(result.poses(unit) for unit in result.units), result.circle_centre, result.arcs
    )


def _off_tracking(result: RunResult, trailer: str) -> Numbers:
    true, error = result.signal(f"off_tracking_true_{trailer}"), error_of_estimate(result, trailer)
    reference, std = (result.signal(f"off_tracking_{kind}_{trailer}") for kind in ("reference", "std"))
    health = result.signal(f"health_{trailer}")
    believed = np.where(health == OK, error, np.nan)
    return {
        "true_rms_m": number(metrics.rms(true)),
        "true_max_m": number(metrics.peak(true)),
        "estimate_error_rms_m": number(metrics.rms(error)),
        "estimate_error_max_m": number(metrics.peak(error)),
        "valid_fraction": number(metrics.valid_fraction(health, true)),
        "reference_error_rms_m": number(metrics.rms(reference - true)),
        "estimate_against_reference_rms_m": number(metrics.rms(error + true - reference)),
        "within_2_5_sigma": number(metrics.within_sigmas(error, std)),
        "ok_within_2_5_sigma": number(metrics.within_sigmas(believed, std)),
        "nees_mean": number(metrics.nees(error, std)),
        **_bridged(result.signal(f"bridged_{trailer}")),
    }


def _bridged(seconds: FloatArray) -> Numbers:
    """Share of the estimates that are bridged by dead reckoning, and the longest bridge."""
    delivered = seconds[np.isfinite(seconds)]
    return {
        "bridged_fraction": number(float(np.mean(delivered > 0.0)) if delivered.size else math.nan),
        "longest_bridge_s": number(metrics.peak(delivered)),
    }


def _swept_path(path: SweptPath) -> Numbers:
    return {
        "max_width_m": number(path.max_width),
        "min_inner_radius_m": number(path.min_inner_radius),
        "tail_swing_m": number(path.tail_swing),
        "tail_swing_entry_m": number(path.tail_swing_entry),
        "tail_swing_exit_m": number(path.tail_swing_exit),
    }


def _road(result: RunResult) -> Numbers:
    edges = RoadEdges(result.road, result.road_half_width if result.road_known else math.inf)
    clearance = wheel_clearance(edges, result.units, [result.poses(unit) for unit in result.units])
    return {"wheel_clearance_left_m": number(clearance.left), "wheel_clearance_right_m": number(clearance.right)}


def _steer(result: RunResult, trailer: str) -> Numbers:
    angles = [result.log[name] for name in result.steer_signals(trailer)]
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
        "longest_loss_s": number(metrics.longest_loss(health, result.log["time"])),
        "drift_percent": number(100.0 * metrics.mean(drift)),
    }


def manifest(result: RunResult | RoverResult) -> dict[str, object]:
    """Versions and hashes that identify the run."""
    return {
        "scenario": result.scenario,
        "seed": result.seed,
        "versions": versions(),
        "signals_sha256": result.log.sha256(),
        **result.manifest,
        **manifest_entry(result.inputs),
    }


def versions() -> dict[str, str]:
    """Versions of the software that determines a run's numbers, and the engine of its vehicle model."""
    installed = {name: importlib.metadata.version(name) for name in ("offtrack", "numpy", "casadi")}
    return {"python": platform.python_version(), **installed, "opencv": cv2.__version__, "engine": engine_name()}
