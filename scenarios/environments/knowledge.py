"""What those who steer trailers are given: what is so, or what a surrogate makes of it.

``estimating`` has what real sensors and estimators make of it.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np
from gymnasium import spaces

from scenarios.environments.core import Feature, Lanes, Observation, observation_space, within
from scenarios.environments.domain import Circumstances
from scenarios.environments.encoders import Encoders
from scenarios.environments.hitch_paths import Beside
from scenarios.environments.surrogate import Estimate, Surrogate, SurrogateParameters
from scenarios.environments.trailer_features import features
from scenarios.report.canvas import Picture
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchMotion
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

Knowledge = Literal["estimate", "surrogate", "truth", "camera"]

_FRAME, _LATENCY = 100, 100  # of the cameras and their estimator, as scenarios have them [ticks]


def check_knowledge(observation: str) -> None:
    """Refuses what is no kind of observation.

    Raises:
        ValueError: one line.
    """
    if observation not in get_args(Knowledge):
        raise ValueError(f"observation = '{observation}' must be one of {', '.join(get_args(Knowledge))}")


class Start(NamedTuple):
    """Episodes that begin."""

    lanes: Lanes  # (k,)
    generators: list[np.random.Generator]  # (k,)
    course: Lanes  # (k,) numbers of their courses
    drawn: Circumstances
    follow_distance: FloatArray  # (k,) [m]


class Knowing(Protocol):
    """What n of them are given."""

    features: tuple[Feature, ...]  # those that are numbers

    @property
    def observation_space(self) -> spaces.Space[Any]:
        """Of one."""

    def begin(self, start: Start, seen: BatchMotion, beside: Beside) -> None:
        """These begin anew, where ``seen`` (n,) has them."""

    def step(self, seen: BatchMotion, beside: Beside) -> None:
        """A control step later."""

    def observe(self) -> Observation:
        """What is known of all, new arrays."""

    def view(self, lane: int) -> Picture | None:
        """What a camera sees, for people; None: there is none."""

    def close(self) -> None:
        """Closes cameras."""


class Told:
    """The truth, or a surrogate of an estimator, and the combination's own sensors."""

    def __init__(self, vehicle: Vehicle, n: int, period: float, surrogate: SurrogateParameters | None) -> None:
        """For control steps of ``period`` [s]; without a surrogate it is the truth."""
        n_steered = len(vehicle.units[-1].steered_axles)
        self.features = features(vehicle, n_steered)
        self.observation_space = observation_space(self.features)
        step = to_ticks(period, "control period")
        made = None if surrogate is None else Surrogate(surrogate, n, step=step, period=_FRAME, latency=_LATENCY)
        self._surrogate, self._encoders = made, Encoders(n, len(vehicle.units))
        self._n_steered, self._follow = n_steered, np.ones(n)
        self._known: Estimate | None = None  # before the first begins
        self._seen: BatchMotion | None = None

    def begin(self, start: Start, seen: BatchMotion, beside: Beside) -> None:
        """They begin with everything known: the buffer has filled on the way to the start."""
        lanes, generators, error = start.lanes, start.generators, start.drawn.sensor_error
        self._follow[lanes], self._seen = start.follow_distance, seen
        self._encoders.begin(lanes, generators, 0.0 * error if self._surrogate is None else error)
        truth = _exact(seen, beside)
        if self._surrogate is not None:
            self._surrogate.begin(lanes, generators, error, start.follow_distance, truth)
        if self._known is None:
            self._known = truth
        for known, true in zip(self._known, truth, strict=True):
            known[lanes] = true[lanes]

    def step(self, seen: BatchMotion, beside: Beside) -> None:
        """A control step later."""
        self._seen, truth = seen, _exact(seen, beside)
        self._known = truth if self._surrogate is None else self._surrogate.step(truth)

    def observe(self) -> Observation:
        """As ``features`` lists them."""
        known, seen = self._known, self._seen
        if known is None or seen is None:
            raise ValueError("nothing is known before an episode begins: reset first")
        articulation, yaw_rates = self._encoders.read(seen)
        values = np.concatenate(
            [
                known.offset[:, None],
                known.direction[:, None],
                known.ahead,
                known.velocity,
                known.age[:, None],
                known.usable[:, None],
                seen.steer[:, -self._n_steered :],
                seen.steer[:, :1],
                seen.velocities[:, 0, :1],
                articulation,
                yaw_rates,
                self._follow[:, None],
            ],
            axis=1,
        )
        return within(values, self.observation_space)

    def view(self, lane: int) -> Picture | None:
        """There is no camera."""
        return None

    def close(self) -> None:
        """Nothing is open."""


def _exact(seen: BatchMotion, beside: Beside) -> Estimate:
    """What is so now."""
    n = len(beside.offset)
    velocity = seen.velocities[:, -1]
    return Estimate(beside.offset, beside.direction, beside.ahead, velocity, np.zeros(n), np.ones(n, dtype=bool))
