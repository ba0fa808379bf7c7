"""Core of single and vector environments: n episodes at once, independent of gymnasium's protocol."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from scenarios.report.canvas import Picture
from vehicle.frames import FloatArray

Lanes = NDArray[np.intp]  # indices of episodes, (k,)
Features = NDArray[np.float32]  # (n, n_features)
Observation = Features | dict[str, NDArray[Any]]  # features, or arrays (n, ...) by the keys of a dict space
Info = dict[str, NDArray[Any]]  # (n,) each


class Feature(NamedTuple):
    """Entry of an observation."""

    name: str
    unit: str
    limit: float  # clipped to +-limit


class Result(NamedTuple):
    """Result of a step."""

    reward: FloatArray  # (n,)
    terminated: NDArray[np.bool_]  # (n,) a mishap
    truncated: NDArray[np.bool_]  # (n,) course completed, or time limit
    outcome: NDArray[np.object_]  # (n,) name of the end; "" while the episode continues


class Core(Protocol):
    """n episodes at once."""

    n: int
    action_space: spaces.Box[np.float32]  # of one episode

    @property
    def observation_space(self) -> spaces.Space[Any]:
        """Space of one episode."""

    @property
    def control_rate(self) -> float:
        """Steps per second of simulated time [Hz]."""

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """Begin episodes in these lanes, each drawn by its generator; the others continue.

        Raises:
            ValueError: one line, if an option is unknown or exceeds its limits.
        """

    def step(self, actions: NDArray[np.float32]) -> Result:
        """Advance all episodes by a control step, with actions (n, n_action) within -1 .. 1."""

    def observe(self) -> Observation:
        """Observation of all episodes, new arrays."""

    def info(self) -> Info:
        """Metrics so far, by their names in a run's summary; new arrays."""

    def picture(self, lane: int) -> Picture:
        """Top view of an episode, with its camera view if there is one."""

    def close(self) -> None:
        """Release resources such as a renderer; a later ``begin`` opens them again."""


def observation_space(features: tuple[Feature, ...]) -> spaces.Box[np.float32]:
    """Space of these features, each within its limit."""
    limits = np.array([feature.limit for feature in features], dtype=np.float32)
    return spaces.Box(-limits, limits, dtype=np.float32)


def within(values: FloatArray, space: spaces.Box[np.float32]) -> Features:
    """Values (n, n_features) as an observation: clipped to the limits, 0 where the physics diverged."""
    clipped = np.minimum(np.maximum(values.astype(np.float32), space.low), space.high)
    if math.isnan(clipped.sum()):
        clipped[np.isnan(clipped)] = 0.0
    return clipped


def of_lane(observation: Observation, lane: int) -> Any:
    """Observation of one episode."""
    if isinstance(observation, dict):
        return {name: values[lane] for name, values in observation.items()}
    return observation[lane]
