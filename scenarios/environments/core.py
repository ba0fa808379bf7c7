"""What single and vector environments are made of: n episodes at once, without any word of gymnasium's protocol."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from scenarios.report.canvas import Picture
from vehicle.frames import FloatArray

Lanes = NDArray[np.intp]  # numbers of episodes, (k,)
Features = NDArray[np.float32]  # (n, n_features)
Observation = Features | dict[str, NDArray[Any]]  # features, or (n, ...) each by the names of a dict space
Info = dict[str, NDArray[Any]]  # (n,) each


class Feature(NamedTuple):
    """An entry of an observation."""

    name: str
    unit: str
    limit: float  # it is cut off at plus and minus this


class Result(NamedTuple):
    """What a step has come to."""

    reward: FloatArray  # (n,)
    terminated: NDArray[np.bool_]  # (n,) a mishap
    truncated: NDArray[np.bool_]  # (n,) the course is done, or the time is up
    outcome: NDArray[np.object_]  # (n,) in words; "" while the episode goes on


class Core(Protocol):
    """n episodes at once."""

    n: int
    action_space: spaces.Box[np.float32]  # of one

    @property
    def observation_space(self) -> spaces.Space[Any]:
        """Of one."""

    @property
    def control_rate(self) -> float:
        """How often a second of simulated time a step is taken [Hz]."""

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """New episodes in these lanes, drawn by a generator each; the others stay as they are.

        Raises:
            ValueError: one line, if an option is none or leaves its limits.
        """

    def step(self, actions: NDArray[np.float32]) -> Result:
        """A control step of all, with actions (n, n_action) within -1 .. 1."""

    def observe(self) -> Observation:
        """What is known of all, a new array."""

    def info(self) -> Info:
        """Metrics of the episodes so far, by the names of a run's summary; new arrays."""

    def picture(self, lane: int) -> Picture:
        """An episode from above, and what its camera sees where there is one."""

    def close(self) -> None:
        """Gives back what the operating system has lent, such as a renderer; a later ``begin`` opens it anew."""


def observation_space(features: tuple[Feature, ...]) -> spaces.Box[np.float32]:
    """The space of these features, each within its limit."""
    limits = np.array([feature.limit for feature in features], dtype=np.float32)
    return spaces.Box(-limits, limits, dtype=np.float32)


def within(values: FloatArray, space: spaces.Box[np.float32]) -> Features:
    """Values (n, n_features) as an observation: cut off at the limits, 0 where the physics broke."""
    seen = np.minimum(np.maximum(values.astype(np.float32), space.low), space.high)
    if math.isnan(seen.sum()):
        seen[np.isnan(seen)] = 0.0
    return seen


def of_lane(observation: Observation, lane: int) -> Any:
    """What a single one of the episodes is given."""
    if isinstance(observation, dict):
        return {name: values[lane] for name, values in observation.items()}
    return observation[lane]
