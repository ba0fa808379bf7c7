"""Observations of trailers: kinds, their protocol, and those that need no rendering (ground truth or a surrogate)."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces

from scenarios.environments.core import Feature, Lanes, Observation, observation_space, within
from scenarios.environments.domain import Circumstances
from scenarios.environments.encoders import Encoders
from scenarios.environments.hitch_paths import PathOffset
from scenarios.environments.surrogate import Estimate, Surrogate, SurrogateParameters
from scenarios.environments.trailer_features import features
from scenarios.report.canvas import Picture
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchMotion
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

ObservationKind = Literal["estimate", "surrogate", "truth", "camera"]

_FRAME, _LATENCY = 100, 100  # of cameras and estimator, as in the scenarios [ticks]


class EpisodeStart(NamedTuple):
    """Episodes that begin."""

    lanes: Lanes  # (k,)
    generators: list[np.random.Generator]  # (k,)
    course: Lanes  # (k,) numbers of their courses
    drawn: Circumstances
    follow_distance: FloatArray  # (k,) [m]


class ObservationSource(Protocol):
    """Observations of n trailers."""

    features: tuple[Feature, ...]  # the numeric part

    @property
    def observation_space(self) -> spaces.Space[Any]:
        """Space of one episode."""

    def begin(self, start: EpisodeStart, motion: BatchMotion, offset: PathOffset) -> None:
        """Begin these episodes at this motion (n,)."""

    def step(self, motion: BatchMotion, offset: PathOffset) -> None:
        """Advance by one control step."""

    def observe(self) -> Observation:
        """Observation of all episodes, new arrays."""

    def view(self, lane: int) -> Picture | None:
        """Camera images for people; None without cameras."""

    def close(self) -> None:
        """Close cameras."""


class TrueOrSurrogate:
    """Observations from ground truth or from a surrogate of an estimator, with the combination's own sensors."""

    def __init__(self, vehicle: Vehicle, n: int, period: float, surrogate: SurrogateParameters | None) -> None:
        """For control steps of ``period`` [s]; without a surrogate, ground truth."""
        self._n_steered = len(vehicle.units[-1].steered_axles)
        self.features = features(vehicle, self._n_steered)
        self.observation_space = observation_space(self.features)
        self._surrogate: Surrogate | None = None
        if surrogate is not None:
            step = to_ticks(period, "control period")
            self._surrogate = Surrogate(surrogate, n, step=step, period=_FRAME, latency=_LATENCY)
        self._encoders, self._follow_distance = Encoders(n, len(vehicle.units)), np.ones(n)
        self._estimate: Estimate | None = None  # before the first episode
        self._motion: BatchMotion | None = None

    def begin(self, start: EpisodeStart, motion: BatchMotion, offset: PathOffset) -> None:
        """Begin with an exact estimate: the buffer has filled on the way to the start."""
        lanes, generators, error = start.lanes, start.generators, start.drawn.sensor_error
        self._follow_distance[lanes], self._motion = start.follow_distance, motion
        self._encoders.begin(lanes, generators, 0.0 * error if self._surrogate is None else error)
        truth = _true_estimate(motion, offset)
        if self._surrogate is not None:
            self._surrogate.begin(lanes, generators, error, start.follow_distance, truth)
        if self._estimate is None:
            self._estimate = truth
        for estimated, true in zip(self._estimate, truth, strict=True):
            estimated[lanes] = true[lanes]

    def step(self, motion: BatchMotion, offset: PathOffset) -> None:
        """Advance by one control step."""
        self._motion, truth = motion, _true_estimate(motion, offset)
        self._estimate = truth if self._surrogate is None else self._surrogate.step(truth)

    def observe(self) -> Observation:
        """Features (n, n_features) as ``features`` lists them."""
        estimate, motion = self._estimate, self._motion
        if estimate is None or motion is None:
            raise ValueError("no observation before an episode begins: reset first")
        articulation, yaw_rates = self._encoders.read(motion)
        values = np.concatenate(
            [
                estimate.offset[:, None],
                estimate.direction[:, None],
                estimate.ahead,
                estimate.velocity,
                estimate.age[:, None],
                estimate.usable[:, None],
                motion.steer[:, -self._n_steered :],
                motion.steer[:, :1],
                motion.velocities[:, 0, :1],
                articulation,
                yaw_rates,
                self._follow_distance[:, None],
            ],
            axis=1,
        )
        return within(values, self.observation_space)

    def view(self, lane: int) -> Picture | None:
        """None: there is no camera."""
        return None

    def close(self) -> None:
        """Nothing is open."""


def _true_estimate(motion: BatchMotion, offset: PathOffset) -> Estimate:
    """Ground truth in the form of an estimate."""
    n = len(offset.offset)
    velocity = motion.velocities[:, -1]
    return Estimate(offset.offset, offset.direction, offset.ahead, velocity, np.zeros(n), np.ones(n, dtype=bool))
