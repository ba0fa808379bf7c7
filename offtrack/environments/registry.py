"""Gymnasium environments by name, single and vector; ``import offtrack`` registers them.

import gymnasium
import offtrack

env = gymnasium.make("offtrack/TrailerSteering-v0")
many = gymnasium.make_vec("offtrack/TrailerSteering-v0", num_envs=1024)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from offtrack.environments.core import Core, Result, checked_count, checked_options
from offtrack.environments.driving import TractorTrailerDriving, TractorTrailerDrivingOptions
from offtrack.environments.rover_options import RoverSteeringOptions
from offtrack.environments.rover_steering import RoverSteering
from offtrack.environments.single import RenderMode, SingleEnv
from offtrack.environments.trailer_steering import TrailerSteering, TrailerSteeringOptions
from offtrack.environments.vector import CoreVectorEnv
from vehicle.foundation.parameter_file import nearest


class Repeated:
    """A core of n episodes whose actions each hold for several control steps of another core.

    Rewards are summed up to the end of an episode. An episode that ends before the last of these steps continues
    without reward and keeps its outcome.
    """

    def __init__(self, core: Core, times: int) -> None:
        """Repeat each action of ``core`` for ``times`` control steps, at least 1."""
        self._core, self._times = core, times
        self.n, self.action_space, self.observation_space = core.n, core.action_space, core.observation_space

    @property
    def control_rate(self) -> float:
        """Actions per second of simulated time [Hz]."""
        return self._core.control_rate / self._times

    def __getattr__(self, name: str) -> Any:
        if name == "_core":  # while a copy is being made
            raise AttributeError(name)
        return getattr(self._core, name)  # all else is the core's: begin, observe, info, picture, close, features

    def step(self, actions: NDArray[np.float32]) -> Result:
        """Advance all episodes by ``times`` control steps with the same actions."""
        total = self._core.step(actions)
        for _ in range(self._times - 1):
            result = self._core.step(actions)
            going = ~(total.terminated | total.truncated)
            total = Result(
                total.reward + result.reward * going,
                total.terminated | (result.terminated & going),
                total.truncated | (result.truncated & going),
                np.where(going, result.outcome, total.outcome),
            )
        return total


CORES: Final[dict[str, tuple[Callable[[int, Any], Core], type[Any]]]] = {  # core and its options
    "TrailerSteering-v0": (TrailerSteering, TrailerSteeringOptions),
    "TractorTrailerDriving-v0": (TractorTrailerDriving, TractorTrailerDrivingOptions),
    "RoverSteering-v0": (RoverSteering, RoverSteeringOptions),
}

_REPEAT: Final = "action_repeat"
_MAX_REPEAT: Final = 1000  # control steps


def single(name: str, render_mode: RenderMode | None = None, **options: Any) -> SingleEnv:
    """One environment of this name; besides its options, ``action_repeat`` repeats each action for that many steps.

    Raises:
        ValueError: one line, if an option is unknown or does not fit.
    """
    return SingleEnv(_builder(name, options), render_mode)


def vector(name: str, num_envs: int = 1, **options: Any) -> CoreVectorEnv:
    """Vector environment of this name; options also include ``autoreset_mode``, ``render_mode``, ``action_repeat``."""
    own = {key: options.pop(key) for key in ("autoreset_mode", "render_mode") if key in options}
    return CoreVectorEnv(_builder(name, options), num_envs, **own)


def _builder(name: str, options: dict[str, Any]) -> Callable[[int], Core]:
    """Function that builds a core of n episodes; it can be pickled."""
    if name not in CORES:
        raise ValueError(f"unknown environment {name!r:.80}{nearest(str(name), CORES)}")
    repeat = checked_count(_REPEAT, options.pop(_REPEAT, 1), _MAX_REPEAT)
    names = [field.name for field in fields(CORES[name][1])]
    for option in options:
        if option not in names:
            raise ValueError(f"{name}: unknown option '{option:.80}'; it has {', '.join((*names, _REPEAT))}")
    return partial(_core, name, repeat, options)


def _core(name: str, repeat: int, options: dict[str, Any], n: int) -> Core:
    build, options_type = CORES[name]
    core = build(n, checked_options(options_type, options, name))
    return core if repeat == 1 else Repeated(core, repeat)
