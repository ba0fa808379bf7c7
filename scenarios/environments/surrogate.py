"""A surrogate of an off-tracking estimator that looks through cameras: the truth with that estimator's errors on it.

It is fitted to the errors of real runs, and stands in for the estimator where rendering would take a hundred times as
long as everything else. The error has a part that stays throughout a run, one that drifts, and one of every single
frame; now and then the estimator is without health for a while. What it does not have: errors that depend on what is
to be seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.trailer_steering.policy import AHEAD
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.parameter_file import read_toml, without_sources

_FRAMES = 600  # of random numbers a vehicle: a minute of frames; a longer episode meets them again


@dataclass(frozen=True, slots=True, kw_only=True)
class SurrogateParameters:
    """What is fitted.

    Raises:
        ValueError: if a value is negative, or a probability or a time is none.
    """

    bias: float  # of a run, 1 sigma [m]
    drift: float  # the part that changes slowly, 1 sigma [m]
    drift_time: float  # in which it falls to 1/e [s]
    noise: float  # of every frame, 1 sigma [m]
    loss_rate: float  # how often health is lost [1/s]
    loss_duration: float  # for how long, on average [s]
    velocity_noise: float  # of the velocities, 1 sigma [m/s]
    yaw_rate_noise: float  # of the yaw rate, 1 sigma [rad/s]

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"surrogate: {field.name} = {value} must be a number that is not negative")
        for name in ("drift_time", "loss_duration"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"surrogate: {name} = {getattr(self, name)} s must be positive")


def load_surrogate(path: Path | None = None) -> SurrogateParameters:
    """Those of a file as ``offtrack fit-surrogate`` writes it; by default the shipped ones.

    Raises:
        ValueError: one line, if the file is none.
    """
    file = Path(str(resources.files("scenarios"))) / "environments" / "surrogate.toml" if path is None else path
    plain = without_sources(read_toml(file))
    known = [field.name for field in fields(SurrogateParameters)]
    if sorted(plain) != sorted(known):
        raise ValueError(f"{file}: has {', '.join(sorted(plain))}, must have {', '.join(known)}")
    return SurrogateParameters(**plain)


def drifted(
    parameters: SurrogateParameters, interval: float, drift: FloatArray | float, normal: FloatArray | float
) -> FloatArray | float:
    """What has become of a drift [m] after an interval [s]: Gauss and Markov's, with a standard normal number."""
    keep = math.exp(-interval / parameters.drift_time)
    return keep * drift + math.sqrt(1.0 - keep**2) * parameters.drift * normal


class Estimate(NamedTuple):
    """What n controllers know of their off-tracking; with ``truth``, what is so."""

    offset: FloatArray  # (n,) [m]
    direction: FloatArray  # (n,) of the path beside the follow point [rad]
    ahead: FloatArray  # (n, 3) [m], as in ``hitch_paths.Beside``
    velocity: FloatArray  # (n, 3) of the hitch v_x, v_y [m/s] along the trailer's axes, yaw rate [rad/s]
    age: FloatArray  # (n,) [s]
    usable: NDArray[np.bool_]  # (n,)


class Surrogate:
    """Estimators of n trailers at ``PERIOD``, each of whose estimates comes ``latency`` later."""

    def __init__(self, parameters: SurrogateParameters, n: int, *, step: int, period: int, latency: int) -> None:
        """With a control step, a frame period and a latency in ticks.

        Raises:
            ValueError: if period or latency is not of whole steps, or the latency is longer than the period.
        """
        for name, ticks in (("period", period), ("latency", latency)):
            if ticks % step or not 0 <= ticks <= period:
                raise ValueError(f"{name} = {ticks} ticks must be whole steps of {step}, and no longer than the period")
        self._parameters, self._step = parameters, step * TICK
        self._period, self._latency = period // step, latency // step
        self._steps = np.zeros(n, dtype=np.intp)
        self._follow, self._scale = np.ones(n), np.ones(n)
        self._bias, self._drift = np.zeros(n), np.zeros(n)
        self._lost = np.zeros(n, dtype=bool)
        self._noise = np.zeros((n, _FRAMES, 6), dtype=np.float32)
        self._pending, self._known = _nothing(n), _nothing(n)
        frame = self._frame = self._period * self._step
        self._losing = min(1.0, frame * parameters.loss_rate)
        self._finding = min(1.0, frame / parameters.loss_duration)

    def begin(
        self,
        lanes: NDArray[np.intp],
        generators: list[np.random.Generator],
        scale: FloatArray,
        follow_distance: FloatArray,
        truth: Estimate,
    ) -> None:
        """Afresh for these trailers, with errors of this ``scale`` (k,); what they know first is ``truth`` (n,)."""
        for lane, rng in zip(lanes.tolist(), generators, strict=True):
            self._noise[lane, :, :5] = rng.standard_normal((_FRAMES, 5), dtype=np.float32)
            self._noise[lane, :, 5] = rng.random(_FRAMES, dtype=np.float32)
        self._steps[lanes], self._lost[lanes] = 0, False
        self._scale[lanes], self._follow[lanes] = scale, follow_distance
        first = self._noise[lanes, -1]  # its last frame is the first that an episode meets again
        self._bias[lanes] = self._parameters.bias * first[:, 0]
        self._drift[lanes] = self._parameters.drift * first[:, 1]
        for known, pending, true in zip(self._known, self._pending, truth, strict=True):
            known[lanes] = pending[lanes] = true[lanes]

    def step(self, truth: Estimate) -> Estimate:
        """What is known now, of what is so now."""
        seen = np.flatnonzero(self._steps % self._period == 0)
        if len(seen):
            self._see(seen, truth)
        if self._latency < self._period:
            self._deliver(np.flatnonzero(self._steps % self._period == self._latency))
        self._steps += 1
        self._known.age[:] += self._step
        return self._known

    def _see(self, lanes: NDArray[np.intp], truth: Estimate) -> None:
        """A frame of these trailers, with its errors, on its way."""
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
        turn = np.where(self._lost[lanes], self._finding, self._losing * scale)
        self._lost[lanes] ^= noise[:, 5] < turn
        pending.usable[lanes] = ~self._lost[lanes]

    def _deliver(self, lanes: NDArray[np.intp]) -> None:
        """What was on its way is known; without health the last that had it stays."""
        good = lanes[self._pending.usable[lanes]]
        for known, pending in zip(self._known[:4], self._pending[:4], strict=True):
            known[good] = pending[good]
        self._known.age[good] = (self._latency - 1) * self._step
        self._known.usable[lanes] = self._pending.usable[lanes]


def _nothing(n: int) -> Estimate:
    return Estimate(
        np.zeros(n), np.zeros(n), np.zeros((n, len(AHEAD))), np.zeros((n, 3)), np.zeros(n), np.ones(n, dtype=bool)
    )
