"""Action repeat: a core whose actions hold for several control steps, which eases learning."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenarios.environments.core import Core, Result


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
