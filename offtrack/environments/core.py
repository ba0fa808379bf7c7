"""Core of single and vector environments: n episodes at once; and checks of actions, seeds and options."""

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple, Protocol, Self

import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from numpy.typing import NDArray
from pydantic import ConfigDict, ValidationError

from offtrack.reports.canvas import Picture
from vehicle.foundation.quantity import Frozen, complaint
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


MAX_ENVS: Final = 65_536  # episodes of one environment: some 2 GB
_FLOAT32: Final = np.dtype(np.float32)


class EnvironmentOptions(Frozen):
    """Base of the options of an environment: every value must be of its declared type."""

    model_config = ConfigDict(arbitrary_types_allowed=True)

    @classmethod
    def of(cls, given: dict[str, Any], environment: str) -> Self:
        """The options with these values, and defaults for the others.

        Raises:
            ValueError: one line naming the option, its value and what is allowed.
        """
        try:
            return cls(**given)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            line, key = complaint(cls, error), str(first["loc"][0])
            if len(first["loc"]) > 1 or first["type"] == "sequence_str":  # inside a value, such as a reward's weight
                line = f"{key} = {given[key]!r:.80}: {first['msg'].replace('Input should be', 'must be')}"
            raise ValueError(f"{environment}: {line}") from None


def checked_actions(actions: object, shape: tuple[int, ...], name: str = "actions") -> NDArray[np.float32]:
    """Actions as 32-bit numbers; those beyond -1 .. 1 stay as they are, the environments limit them.

    Raises:
        ValueError: one line, if they are not numbers of this shape or not finite.
    """
    if type(actions) is not np.ndarray or actions.dtype is not _FLOAT32 or actions.shape != shape:
        return _converted(actions, shape, name)
    if 0 in np.isfinite(actions).tobytes():  # a search of bytes takes a third of the time of ``all``
        _refuse_not_finite(actions, name)
    return actions


def _converted(actions: object, shape: tuple[int, ...], name: str) -> NDArray[np.float32]:
    try:
        values = np.asarray(actions)
    except ValueError:
        values = np.empty(0, dtype=object)  # rows of different lengths
    if values.dtype.kind not in "iuf":
        raise ValueError(f"{name} = {actions!r:.80} must be numbers of shape {shape}")
    if values.shape != shape:
        raise ValueError(f"{name} of shape {values.shape} must be of shape {shape}")
    if not np.isfinite(values).all():
        _refuse_not_finite(values, name)
    limited: NDArray[np.float32] = np.clip(values, -1, 1).astype(np.float32)
    return limited  # a large 64-bit number is infinite in 32 bits


def _refuse_not_finite(values: NDArray[Any], name: str) -> None:
    index = tuple(np.argwhere(~np.isfinite(values))[0].tolist())
    place = ", ".join(map(str, index))
    raise ValueError(f"{name}[{place}] = {values[index]} must be a finite number (beyond -1 .. 1 it is limited)")


def is_whole(value: Any) -> bool:
    """True for a Python or numpy integer that is no boolean."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def checked_seed(seed: Any) -> int | None:
    """A seed as a Python integer, or None.

    Raises:
        ValueError: one line, if it is anything else or negative.
    """
    if seed is None:
        return None
    if not is_whole(seed) or seed < 0:
        raise ValueError(f"seed = {seed!r:.80} must be a whole number >= 0, or None")
    return int(seed)


def checked_count(name: str, value: Any, most: int) -> int:
    """A whole number from 1 to ``most``.

    Raises:
        ValueError: one line, if it is anything else.
    """
    if not is_whole(value) or not 1 <= value <= most:
        raise ValueError(f"{name} = {value!r:.80} must be a whole number, at least 1 and at most {most}")
    return int(value)


def reset_options(options: Any) -> dict[str, Any]:
    """Options of a reset as a new dictionary.

    Raises:
        ValueError: one line, if they are no dictionary of options by name.
    """
    if options is None:
        return {}
    if not isinstance(options, dict) or not all(isinstance(name, str) for name in options):
        raise ValueError(f"options = {options!r:.80} must be a dictionary of reset options by name")
    return dict(options)


def call_error(call: str, *, closed: bool) -> Exception:
    """Error of a call that an environment cannot serve now."""
    if closed:
        return ClosedEnvironmentError(f"{call} after close: make the environment again")
    return ResetNeeded(f"{call} before reset: an episode must begin first")
