"""The result of a rover run in memory, and its summary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from estimators.slip.reference import LaserSlip
from scenarios.results import metrics
from scenarios.results.log import LOST, Log
from scenarios.results.numbers import Numbers, Summary, number, timing_numbers
from scenarios.results.paced import Paced
from scenarios.results.run_inputs import RunInputs
from scenarios.results.timing import Timing
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TraceFrame:
    """A colour picture of the camera for reports and videos."""

    tick: int
    jpeg: bytes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverResult:
    """The result of a finished rover run."""

    scenario: str  # name
    scenario_toml: str  # resolved: runs again identically
    seed: int
    outcome: str  # "completed", "entrapped", "failed: …", …
    log: Log
    rover: str
    path: FloatArray  # (n, 2) reference path [m]
    rig: TraceRig
    timing: Timing
    frames: tuple[TraceFrame, ...]
    manifest: Mapping[str, str]
    traceback: str = ""  # of the exception that ended the run
    inputs: RunInputs = field(default_factory=RunInputs)  # files and own modules that the scenario names
    paced: Paced | None = None  # deadlines kept and missed; None: the run was not paced

    @property
    def slip_error(self) -> FloatArray:
        """Estimated less true slip angle at the estimate's own time [rad] (n_rows,); NaN where there is none."""
        return self.log["slip_angle_estimate"] - self.log["slip_angle_true"]


def rover_summary(result: RoverResult) -> Summary:
    """The run in numbers, ready for JSON: null stands for numbers that do not apply or were not measured."""
    return {
        "outcome": result.outcome,
        "scenario": result.scenario,
        "seed": result.seed,
        "slip": _slip(result),
        "position": _position(result.log),
        "wheels": _wheels(result),
        "timing": timing_numbers(result.timing),
        **({"paced": result.paced.numbers(), "warnings": list(result.paced.warnings)} if result.paced else {}),
    }


def _slip(result: RoverResult) -> Numbers:
    log, error = result.log, np.degrees(result.slip_error)
    lagged = np.degrees(log["slip_angle_lagged"] - log["slip_angle_true"])
    health = log["health"]
    captures = np.isfinite(health)
    return {
        "error_rms_deg": number(metrics.rms(error)),
        "error_max_deg": number(metrics.peak(error)),
        "valid_fraction": number(float(np.mean(health[captures] < LOST))) if captures.any() else None,
        "cross_track_rms_m": number(metrics.rms(log["cross_track_true"])),
        "cross_track_max_m": number(metrics.peak(log["cross_track_true"])),
        "lagged_error_rms_deg": number(metrics.rms(lagged)),
        "within_2_5_sigma": number(metrics.within_sigmas(result.slip_error, log["slip_angle_std"])),
        "true_mean_deg": number(math.degrees(metrics.mean(log["slip_angle_true"]))),
        "reference_error_rms_deg": number(metrics.rms(np.degrees(_reference_error(log)))),
    }


def _reference_error(log: Log) -> FloatArray:
    """Slip angle by laser tracker and compass less the true one at the same time [rad]."""
    if not len(log):
        return np.empty(0)
    time, delay = log["time"], LaserSlip().delay()
    true_then = np.interp(time - delay, time, log["slip_angle_true"])
    error: FloatArray = np.where(time >= delay, log["slip_angle_laser"] - true_then, np.nan)
    return error


def _position(log: Log) -> Numbers:
    """Final position errors of the two dead reckonings, and the distance travelled."""
    if not len(log):
        return {}
    distance = float(np.sum(np.hypot(np.diff(log["x"]), np.diff(log["y"]))))
    return {
        "distance_m": number(distance),
        **{
            f"{name}_error_m": number(
                math.hypot(log[f"x_{name}"][-1] - log["x"][-1], log[f"y_{name}"][-1] - log["y"][-1])
            )
            for name in ("wheels", "corrected")
        },
    }


def _wheels(result: RoverResult) -> Numbers:
    ratios, sinkages = (
        np.array([result.log[f"{quantity}_{wheel.name}"] for wheel in result.rig.wheels])
        for quantity in ("slip_ratio", "sinkage")
    )
    return {
        "slip_ratio_mean": number(metrics.mean(ratios.ravel())),
        "sinkage_max_m": number(metrics.peak(sinkages.ravel())),
    }
