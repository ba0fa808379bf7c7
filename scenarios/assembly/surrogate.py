"""Surrogate of an off-tracking estimator with cameras: ground truth plus that estimator's errors; and its fit to runs.

It is fitted to the errors of runs with cameras, and saves rendering, which would take a hundred times as long as
everything else. The error is the sum of a bias, constant in a run, a drift, and noise of single frames; now and then
the estimator loses health for a while. Errors that depend on the scene are not modelled.

Comparing such a run with a camera run shows the effect of the cameras on a policy trained with the surrogate.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import ClassVar, NamedTuple, Self

import numpy as np
import tomli_w
from numpy.typing import NDArray

from controllers.trailer_steering.policy import AHEAD
from estimators.context import TrailerContext
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.reference import ReferenceMemory, ReferenceOffTracking
from scenarios.results.log import LOST, read_columns
from scenarios.results.metrics import estimate_error
from sensors.messages import BodyPose
from vehicle.clock import TICK
from vehicle.foundation.quantity import Frozen, checked, quantity
from vehicle.foundation.user_file import FileKind, read_toml, shown, without_sources
from vehicle.frames import FloatArray

_FRAMES = 600  # of random numbers per vehicle: a minute; a longer episode repeats them


class SurrogateParameters(Frozen):
    """Parameters of the surrogate."""

    bias: float = quantity(..., "m", 0.0, math.inf, "Constant in a run, 1 sigma.")
    drift: float = quantity(..., "m", 0.0, math.inf, "Stationary value of the drift, 1 sigma.")
    drift_time: float = quantity(..., "s", 0.0, math.inf, "Time constant of the drift.", above=True)
    noise: float = quantity(..., "m", 0.0, math.inf, "Of single frames, 1 sigma.")
    loss_rate: float = quantity(..., "1/s", 0.0, math.inf, "Losses of health.")
    loss_duration: float = quantity(..., "s", 0.0, math.inf, "Mean duration of a loss.", above=True)
    velocity_noise: float = quantity(..., "m/s", 0.0, math.inf, "Of the velocities, 1 sigma.")
    yaw_rate_noise: float = quantity(..., "rad/s", 0.0, math.inf, "Of the yaw rate, 1 sigma.")


def load_surrogate(path: Path | None = None) -> SurrogateParameters:
    """Parameters from a file of ``offtrack fit-surrogate``; by default the shipped ones.

    Raises:
        ValueError: one line, if the file is not such a file.
    """
    file = Path(str(resources.files("scenarios"))) / "assembly" / "surrogate.toml" if path is None else path
    return checked(SurrogateParameters, without_sources(read_toml(file)), str(file))


def drifted(
    parameters: SurrogateParameters, interval: float, drift: FloatArray | float, normal: FloatArray | float
) -> FloatArray | float:
    """Drift [m] after an interval [s]: a Gauss-Markov process, driven by a standard normal number."""
    keep = math.exp(-interval / parameters.drift_time)
    return keep * drift + math.sqrt(1.0 - keep**2) * parameters.drift * normal


class Estimate(NamedTuple):
    """Off-tracking estimates, or ground truth, of n trailers."""

    offset: FloatArray  # (n,) [m]
    direction: FloatArray  # (n,) of the path at the follow point [rad]
    ahead: FloatArray  # (n, 3) [m], as in ``hitch_paths.PathOffset``
    velocity: FloatArray  # (n, 3) of the hitch v_x, v_y [m/s] along the trailer's axes, yaw rate [rad/s]
    age: FloatArray  # (n,) [s]
    usable: NDArray[np.bool_]  # (n,)


class Surrogate:
    """Surrogate estimators of n trailers, whose estimates arrive ``latency`` after their frame."""

    def __init__(self, parameters: SurrogateParameters, n: int, *, step: int, period: int, latency: int) -> None:
        """For a control step, a frame period and a latency in ticks.

        Raises:
            ValueError: if period or latency is not a multiple of the step, or the latency exceeds the period.
        """
        for name, ticks in (("period", period), ("latency", latency)):
            if ticks % step or not 0 <= ticks <= period:
                raise ValueError(
                    f"{name} = {ticks} ticks must be a multiple of the step, {step} ticks, and at most the period"
                )
        self._parameters, self._step = parameters, step * TICK
        self._period, self._latency = period // step, latency // step
        self._steps = np.zeros(n, dtype=np.intp)
        self._follow, self._scale = np.ones(n), np.ones(n)
        self._bias, self._drift = np.zeros(n), np.zeros(n)
        self._lost = np.zeros(n, dtype=bool)
        self._noise = np.zeros((n, _FRAMES, 6), dtype=np.float32)
        self._pending, self._delivered = _empty(n), _empty(n)
        frame = self._frame = self._period * self._step
        self._loss_chance = min(1.0, frame * parameters.loss_rate)
        self._recovery_chance = min(1.0, frame / parameters.loss_duration)

    def begin(
        self,
        lanes: NDArray[np.intp],
        generators: list[np.random.Generator],
        scale: FloatArray,
        follow_distance: FloatArray,
        truth: Estimate,
    ) -> None:
        """Restart these trailers with errors of this ``scale`` (k,) and ``truth`` (n,) as the first estimate."""
        for lane, rng in zip(lanes.tolist(), generators, strict=True):
            self._noise[lane, :, :5] = rng.standard_normal((_FRAMES, 5), dtype=np.float32)
            self._noise[lane, :, 5] = rng.random(_FRAMES, dtype=np.float32)
        self._steps[lanes], self._lost[lanes] = 0, False
        self._scale[lanes], self._follow[lanes] = scale, follow_distance
        first = self._noise[lanes, -1]  # the last frame is the last to be used again
        self._bias[lanes] = self._parameters.bias * first[:, 0]
        self._drift[lanes] = self._parameters.drift * first[:, 1]
        for delivered, pending, true in zip(self._delivered, self._pending, truth, strict=True):
            delivered[lanes] = pending[lanes] = true[lanes]

    def step(self, truth: Estimate) -> Estimate:
        """Estimates delivered by now, one control step later."""
        (due,) = (self._steps % self._period == 0).nonzero()
        if len(due):
            self._capture(due, truth)
        if self._latency < self._period:
            self._deliver((self._steps % self._period == self._latency).nonzero()[0])
        self._steps += 1
        self._delivered.age[:] += self._step
        return self._delivered

    def _capture(self, lanes: NDArray[np.intp], truth: Estimate) -> None:
        """Estimate these trailers from a frame captured now; it is delivered later."""
        if self._latency == self._period:
            self._deliver(lanes[self._steps[lanes] > 0])
        p, scale = self._parameters, self._scale[lanes]
        noise = self._noise[lanes, self._steps[lanes] // self._period % _FRAMES]
        self._drift[lanes] = drifted(p, self._frame, self._drift[lanes], noise[:, 0].astype(np.float64))
        error = scale * (self._bias[lanes] + self._drift[lanes] + p.noise * noise[:, 1])
        pending, follow = self._pending, self._follow[lanes]
        pending.offset[lanes] = truth.offset[lanes] + error
        pending.direction[lanes] = truth.direction[lanes] - error / follow  # the error grows from the hitch to the rear
        pending.ahead[lanes] = truth.ahead[lanes] + error[:, None] * (1.0 - np.array(AHEAD))
        spread = np.array([p.velocity_noise, p.velocity_noise, p.yaw_rate_noise])
        pending.velocity[lanes] = truth.velocity[lanes] + scale[:, None] * spread * noise[:, 2:5]
        chance = np.where(self._lost[lanes], self._recovery_chance, self._loss_chance * scale)
        self._lost[lanes] ^= noise[:, 5] < chance
        pending.usable[lanes] = ~self._lost[lanes]

    def _deliver(self, lanes: NDArray[np.intp]) -> None:
        """Deliver pending estimates; without health the last healthy values stay."""
        good = lanes[self._pending.usable[lanes]]
        for delivered, pending in zip(self._delivered[:4], self._pending[:4], strict=True):
            delivered[good] = pending[good]
        self._delivered.age[good] = (self._latency - 1) * self._step
        self._delivered.usable[lanes] = self._pending.usable[lanes]


def _empty(n: int) -> Estimate:
    return Estimate(
        np.zeros(n), np.zeros(n), np.zeros((n, len(AHEAD))), np.zeros((n, 3)), np.zeros(n), np.ones(n, dtype=bool)
    )


_ESTIMATOR_FRAMES = 4096  # of random numbers: several minutes; a longer run repeats them


class SurrogateMemory(NamedTuple):
    """Memory between poses."""

    reference: ReferenceMemory
    frames: int  # so far
    drift: float  # [m]
    lost: bool


class SurrogateOffTracking:
    """Off-tracking from exact poses, with the errors and losses of ``surrogate.SurrogateParameters`` on it."""

    sensor: ClassVar[str] = "reference_pose"

    def __init__(
        self, follow_distance: float, rng: np.random.Generator, parameters: SurrogateParameters | None = None
    ) -> None:
        """For a follow point ``follow_distance`` [m] behind the hitch; by default with the shipped parameters.

        Raises:
            ValueError: if ``follow_distance`` is not positive.
        """
        self._parameters = load_surrogate() if parameters is None else parameters
        self._exact = ReferenceOffTracking(follow_distance)
        self._follow_distance = follow_distance
        self._bias, self._first_drift = rng.standard_normal(2) * [self._parameters.bias, self._parameters.drift]
        self._normal = rng.standard_normal((_ESTIMATOR_FRAMES, 5))
        self._chance = rng.random(_ESTIMATOR_FRAMES)

    @classmethod
    def of(cls, context: TrailerContext) -> Self:
        """Estimator for the context's trailer, with errors from its random stream."""
        return cls(context.follow_distance, context.rng)

    def init(self) -> SurrogateMemory:
        """Memory before the first pose."""
        return SurrogateMemory(self._exact.init(), 0, float(self._first_drift), False)

    def step(self, memory: SurrogateMemory, pose: BodyPose) -> tuple[SurrogateMemory, OffTracking | None]:
        """Memory with the pose in it, and the off-tracking at its tick; None for the first pose."""
        before = memory.reference.previous
        reference, exact = self._exact.step(memory.reference, pose)
        if before is None or exact is None:
            return memory._replace(reference=reference), exact
        p, k = self._parameters, memory.frames % _ESTIMATOR_FRAMES
        interval = (pose.tick - before.tick) * TICK
        drift = float(drifted(p, interval, memory.drift, self._normal[k, 0]))
        chance = interval / p.loss_duration if memory.lost else interval * p.loss_rate
        lost = memory.lost ^ bool(self._chance[k] < chance)
        after = SurrogateMemory(reference, memory.frames + 1, drift, lost)
        if exact.health is Health.LOST:
            return after, exact
        if lost:
            return after, replace(exact, value=0.0, std=math.inf, health=Health.LOST)
        error = float(self._bias) + drift + p.noise * float(self._normal[k, 1])
        return after, self._with_error(exact, error, self._normal[k, 2:])

    def _with_error(self, exact: OffTracking, error: float, normal: FloatArray) -> OffTracking:
        """The estimate with an error that grows linearly from 0 at the hitch to ``error`` at the follow point [m]."""
        p = self._parameters
        back = exact.path[:, 0] / -self._follow_distance
        v_x, v_y = p.velocity_noise * normal[:2]
        return replace(
            exact,
            value=exact.value + error,
            std=math.sqrt(p.bias**2 + p.drift**2 + p.noise**2),
            path=exact.path + np.column_stack([np.zeros(len(back)), error * back]),
            hitch_direction=exact.hitch_direction - error / self._follow_distance,
            path_tangent=exact.path_tangent - error / self._follow_distance,
            v_x=exact.v_x + float(v_x),
            v_y=exact.v_y + float(v_y),
            yaw_rate=exact.yaw_rate + p.yaw_rate_noise * float(normal[2]),
        )


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
    """
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
        for name in SurrogateParameters.model_fields
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
