"""Observations of trailers: kinds, features, protocol, and those without rendering (ground truth, surrogate)."""

from __future__ import annotations

import math
from typing import Any, Final, Literal, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.trailer_steering.policy import feature_names
from offtrack.environments.core import Feature, Lanes, Observation, observation_space, within
from offtrack.environments.domain import Circumstances
from offtrack.environments.hitch_paths import PathOffset
from offtrack.reports.canvas import Picture
from scenarios.assembly.surrogate import Estimate, Surrogate, SurrogateParameters
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchMotion
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_ARTICULATION, _GYRO = math.radians(0.1), math.radians(0.1)  # biases as in that module, 1 sigma [rad], [rad/s]


class Encoders:
    """Articulation encoders and gyros of n vehicles."""

    def __init__(self, n: int, n_units: int) -> None:
        """Without errors until they ``begin``."""
        self._articulation, self._gyro = np.zeros((n, n_units - 1)), np.zeros((n, n_units))

    def begin(self, lanes: NDArray[np.intp], generators: list[np.random.Generator], scale: FloatArray) -> None:
        """Draw errors of this ``scale`` (k,) for these vehicles."""
        n_hitches, n_units = self._articulation.shape[1], self._gyro.shape[1]
        drawn = scale[:, None] * np.array([rng.standard_normal(n_hitches + n_units) for rng in generators])
        self._articulation[lanes] = _ARTICULATION * drawn[:, :n_hitches]
        self._gyro[lanes] = _GYRO * drawn[:, n_hitches:]

    def read(self, motion: BatchMotion) -> tuple[FloatArray, FloatArray]:
        """Articulation (n, N - 1) [rad] and yaw rates (n, N) [rad/s]."""
        psi = motion.poses[:, :, 2]
        return psi[:, :-1] - psi[:, 1:] + self._articulation, motion.velocities[:, :, 2] + self._gyro


def features(vehicle: Vehicle, n_steered: int) -> tuple[Feature, ...]:
    """All entries of the observation, as a policy in the loop gets them."""
    names = feature_names(n_steered, [unit.name for unit in vehicle.units])
    return tuple(
        Feature(name, *next(kind for start, kind in _KINDS.items() if name.startswith(start))) for name in names
    )


def own_features(vehicle: Vehicle, n_steered: int) -> tuple[Feature, ...]:
    """Features next to an image: its age, and the signals of the combination's own sensors."""
    entries = features(vehicle, n_steered)
    names = [feature.name for feature in entries]
    return (entries[names.index("age")], *entries[names.index("usable") + 1 :])


_KINDS: Final = {  # prefix of the name: unit and limit
    "off_tracking": ("m", 10.0),
    "path_direction": ("rad", 3.2),
    "path_": ("m", 20.0),
    "hitch_v_": ("m/s", 40.0),
    "trailer_yaw_rate": ("rad/s", 5.0),
    "age": ("s", 60.0),
    "usable": ("-", 1.0),
    "steer_": ("rad", 1.6),
    "speed": ("m/s", 40.0),
    "articulation_": ("rad", 3.2),
    "yaw_rate_": ("rad/s", 5.0),
    "follow_distance": ("m", 50.0),
}


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
