"""A core whose actions hold for several control steps: decisions that are farther apart are easier to learn from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenarios.environments.core import Core, Info, Lanes, Observation, Result
from scenarios.report.canvas import Picture


class Repeated:
    """A core of n episodes in which every action counts for so many control steps of another one.

    Rewards of these steps are added up to the end of an episode; what has ended within them drives on to the last of
    them, without reward and with its outcome kept.
    """

    def __init__(self, core: Core, times: int) -> None:
        """Actions of ``core`` hold for ``times`` of its control steps.

        Raises:
            ValueError: if ``times`` is less than 1.
        """
        if times < 1:
            raise ValueError(f"action_repeat = {times} must be at least 1 control step")
        self._core, self._times = core, times
        self.n, self.action_space, self.observation_space = core.n, core.action_space, core.observation_space

    @property
    def control_rate(self) -> float:
        """How often a second of simulated time an action is taken [Hz]."""
        return self._core.control_rate / self._times

    def __getattr__(self, name: str) -> Any:
        if name == "_core":  # not there yet: a copy is being made
            raise AttributeError(name)
        return getattr(self._core, name)  # features and whatever else the core tells of itself

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """As of the core."""
        self._core.begin(lanes, generators, options)

    def step(self, actions: NDArray[np.float32]) -> Result:
        """``times`` control steps of all with the same actions."""
        total = self._core.step(actions)
        for _ in range(self._times - 1):
            told = self._core.step(actions)
            going = ~(total.terminated | total.truncated)
            total = Result(
                total.reward + told.reward * going,
                total.terminated | (told.terminated & going),
                total.truncated | (told.truncated & going),
                np.where(going, told.outcome, total.outcome),
            )
        return total

    def observe(self) -> Observation:
        """As of the core."""
        return self._core.observe()

    def info(self) -> Info:
        """As of the core."""
        return self._core.info()

    def picture(self, lane: int) -> Picture:
        """As of the core."""
        return self._core.picture(lane)
