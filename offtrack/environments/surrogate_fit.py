"""Fit of the surrogate off-tracking estimator to the errors of runs with the real one."""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomli_w

from scenarios.assembly.surrogate import SurrogateParameters
from scenarios.results.log import LOST, read_columns
from scenarios.results.metrics import estimate_error
from vehicle.foundation.user_file import FileKind, read_toml, shown
from vehicle.frames import FloatArray

_REAL = ("viso_ot", "ground_watching", "ground_watching_single")  # estimators with cameras
_LARGEST = 1e6  # time [s] or off-tracking [m] of a run
_MIN_FRAMES = 50  # of a run: fewer do not show drift
_LAGS = 20  # of the autocovariance, in frames: two seconds
_VELOCITY_NOISE, _YAW_RATE_NOISE = 0.01, 0.002  # see ``surrogate_toml`` [m/s], [rad/s]
_FRAME = 0.1  # [s]


class RunErrors(NamedTuple):
    """Errors of one run."""

    error: FloatArray  # of each frame from the first with health, NaN without health [m]
    interval: float  # between frames [s]


def run_errors(directory: Path) -> RunErrors:
    """Errors of the run in this directory.

    Raises:
        ValueError: one line, if it is not a run with cameras and an estimator, or too short.
    """
    scenario, signals = directory / "scenario.toml", directory / "signals.parquet"
    if not os.path.lexists(scenario):
        raise ValueError(f"{directory}: no scenario.toml: not a run directory")
    estimator = read_toml(scenario, FileKind.SCENARIO).get("off_tracking")
    if estimator not in _REAL:
        raise ValueError(f"{scenario}: off_tracking = {shown(str(estimator))} must be one of {', '.join(_REAL)}")
    table = read_columns(signals, ("time", "off_tracking_estimate", "off_tracking_true", "health"))
    time, estimate, truth, health = table.values()
    if not np.all(np.diff(time) > 0.0) or np.any(np.abs(np.concatenate([time, estimate, truth])) > _LARGEST):
        raise ValueError(f"{signals}: time must increase, and all numbers must be within {_LARGEST:g}")
    frames = np.flatnonzero(np.isfinite(health) & np.isfinite(truth))
    error = estimate_error(estimate, truth, health)[frames]
    healthy = np.flatnonzero((health[frames] < LOST) & np.isfinite(error))
    if len(healthy) < _MIN_FRAMES:
        raise ValueError(f"{directory}: has {len(healthy)} estimates, must have at least {_MIN_FRAMES}")
    return RunErrors(error[healthy[0] :], float(np.median(np.diff(time[frames]))))


def fitted(runs: Sequence[RunErrors]) -> SurrogateParameters:
    """Parameters of the surrogate whose errors have the moments of the runs' errors.

    The mean of a run is its bias. The part of the rest that correlates from frame to frame is drift, the remainder is
    noise of single frames.

    Raises:
        ValueError: if there is no run.
    """
    if not runs:
        raise ValueError("no run to fit to")
    biases = np.array([float(np.nanmean(run.error)) for run in runs])
    interval = float(np.mean([run.interval for run in runs]))
    correlation = _autocovariance([run.error - bias for run, bias in zip(runs, biases, strict=True)])
    drift, drift_time = _exponential(correlation[1:], interval)
    lost, losses, time = 0, 0, 0.0
    for run in runs:
        gone = ~np.isfinite(run.error)
        lost += int(gone.sum())
        losses += int((gone[1:] & ~gone[:-1]).sum())
        time += int((~gone).sum()) * interval
    return SurrogateParameters(
        bias=float(np.sqrt(np.mean(biases**2))),
        drift=math.sqrt(drift),
        drift_time=drift_time,
        noise=math.sqrt(max(float(correlation[0]) - drift, 0.0)),
        loss_rate=(losses + 0.5) / time,  # half a loss added: no loss in these runs does not mean zero rate
        loss_duration=max(lost / losses, 1.0) * interval if losses else interval,
        velocity_noise=_VELOCITY_NOISE,
        yaw_rate_noise=_YAW_RATE_NOISE,
    )


def surrogate_toml(parameters: SurrogateParameters, runs: int, frames: int) -> str:
    """TOML file of the parameters with their source."""
    fit = f"fitted to {frames} frames of {runs} runs with cameras, by offtrack fit-surrogate"
    assumed = "assumed: some millimetres and hundredths of a degree of odometry over a frame of 0.1 s"
    table = {
        name: {"value": float(f"{getattr(parameters, name):.4g}"), "source": assumed if "_noise" in name else fit}
        for name in SurrogateParameters.__dataclass_fields__
    }
    return tomli_w.dumps(table)


def _autocovariance(errors: Sequence[FloatArray]) -> FloatArray:
    """Mean product of errors at each lag in frames, from lag 0, over all runs; 0 where no two errors have that lag."""
    covariance = np.zeros(_LAGS)
    for lag in range(_LAGS):
        products = np.concatenate([error[lag:] * error[: len(error) - lag] for error in errors])
        if np.isfinite(products).any():
            covariance[lag] = np.nanmean(products)
    return covariance


def _exponential(covariance: FloatArray, interval: float) -> tuple[float, float]:
    """Variance and time constant [s] of an exponential through covariances from lag 1 on.

    Least squares on the logarithms of those above a tenth of the first; the tail is noise.
    """
    if covariance[0] <= 0.0:
        return 0.0, _FRAME
    below = np.flatnonzero(covariance < 0.1 * covariance[0])
    used = covariance[: max(2, below[0] if len(below) else len(covariance))]
    used = np.maximum(used, 1e-3 * covariance[0])
    lags = interval * np.arange(1, len(used) + 1)
    slope, level = np.polyfit(lags, np.log(used), 1)
    return math.exp(level), max(-1.0 / min(slope, -1e-2), _FRAME)
