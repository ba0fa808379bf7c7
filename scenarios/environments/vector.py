"""Many episodes as a gymnasium vector environment, in all autoreset modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from scenarios.environments.core import Core, Info, Observation, Result, of_lane
from scenarios.report.canvas import Picture

Flags = NDArray[np.bool_]
_StepResult = tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]


class CoreVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Environment around a core of many episodes; sub-environment k equals a single one with seed s + k."""

    def __init__(
        self,
        build: Callable[[int], Core],
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        """``build(n)`` returns a core of n episodes.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs} must be at least 1")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode = '{render_mode}' of a vector environment must be rgb_array")
        self._arguments = (build, num_envs, autoreset_mode, render_mode)
        self._mode = AutoresetMode(autoreset_mode)
        self.core = build(num_envs)
        self.num_envs, self.render_mode = num_envs, render_mode
        rate = round(self.core.control_rate)
        self.metadata = {"autoreset_mode": self._mode, "render_modes": ["rgb_array"], "render_fps": rate}
        self.single_action_space = self.core.action_space
        self.single_observation_space = self.core.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._generators: list[np.random.Generator] = []
        self._done = np.zeros(num_envs, dtype=bool)

    def __reduce__(self) -> tuple[Any, ...]:
        return (_again, self._arguments)  # episodes are not pickled: they begin again

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes in all sub-environments, or in those of ``options["reset_mask"]``.

        Raises:
            ValueError: if seeds or mask do not fit, or an option is unknown.
        """
        given = dict(options or {})
        mask = np.asarray(given.pop("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask must be {self.num_envs} booleans, at least one of them True")
        self._seed(seed, mask)
        self._begin(mask, given)
        return self.core.observe(), self._masked(self.core.info(), mask)

    def step(self, actions: NDArray[np.float32]) -> _StepResult:
        """Advance all by a control step; ended episodes restart according to the autoreset mode.

        Raises:
            ValueError: if the actions are not (num_envs, n_action).
        """
        actions = np.asarray(actions, dtype=np.float32)
        if actions.shape != self.action_space.shape:
            raise ValueError(f"actions of shape {actions.shape} must be {self.action_space.shape}")
        result = self.core.step(actions)
        if self._mode is AutoresetMode.NEXT_STEP:
            return self._after(self._restarted(result))
        if self._mode is AutoresetMode.SAME_STEP:
            return self._same_step(result)
        return self._after(result)

    def render(self) -> tuple[Picture, ...] | None:
        """Top view of every episode, for ``rgb_array``."""
        if self.render_mode != "rgb_array":
            return None
        return tuple(self.core.picture(lane) for lane in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close cameras."""
        self.core.close()

    def _seed(self, seed: int | Sequence[int | None] | None, mask: Flags) -> None:
        if seed is None or isinstance(seed, int | np.integer):
            seeds: Sequence[int | None] = [None if seed is None else int(seed) + k for k in range(self.num_envs)]
        else:
            seeds = seed
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds for {self.num_envs} environments: give one per environment")
        fresh = not self._generators
        if fresh:
            self._generators = [np_random(s)[0] for s in seeds]
            return
        for lane in np.flatnonzero(mask).tolist():
            if seeds[lane] is not None:
                self._generators[lane] = np_random(seeds[lane])[0]

    def _begin(self, mask: Flags, options: dict[str, Any]) -> None:
        lanes = np.flatnonzero(mask)
        self.core.begin(lanes, [self._generators[lane] for lane in lanes.tolist()], options)
        self._done[mask] = False

    def _restarted(self, result: Result) -> Result:
        """Result with the episodes that ended one step earlier restarted; their actions are ignored."""
        again = self._done.copy()
        if not again.any():
            return result
        self._begin(again, {})
        going = ~again
        outcome = np.where(again, "", result.outcome)
        return Result(result.reward * going, result.terminated & going, result.truncated & going, outcome)

    def _after(self, result: Result) -> _StepResult:
        self._done = result.terminated | result.truncated
        return self.core.observe(), result.reward, result.terminated, result.truncated, self._info(result)

    def _same_step(self, result: Result) -> _StepResult:
        """Restart ended episodes at once; their last observations and infos are in the info."""
        done = result.terminated | result.truncated
        info = self._info(result)
        if done.any():
            last = self.core.observe()
            final = np.full(self.num_envs, None, dtype=object)
            for lane in np.flatnonzero(done).tolist():
                final[lane] = of_lane(last, lane)
            ended: dict[str, Any] = {"final_obs": final, "_final_obs": done}
            ended |= {"final_info": self._masked(self.core.info() | {"outcome": result.outcome}, done)}
            self._begin(done, {})
            info = {**self._info(result._replace(outcome=np.full(self.num_envs, "", dtype=object))), **ended}
            info["_final_info"] = done
        return self.core.observe(), result.reward, result.terminated, result.truncated, info

    def _info(self, result: Result) -> dict[str, Any]:
        info = self._masked(self.core.info(), np.ones(self.num_envs, dtype=bool))
        ended = result.terminated | result.truncated
        if ended.any() and result.outcome.any():
            info |= {"outcome": result.outcome, "_outcome": ended}
        return info

    @staticmethod
    def _masked(info: Info, mask: Flags) -> dict[str, Any]:
        """Info with a mask ``_name`` for each entry, as gymnasium defines it."""
        return {**info, **{f"_{name}": mask for name in info}}


def _again(build: Callable[[int], Core], num_envs: int, mode: AutoresetMode | str, render: str | None) -> CoreVectorEnv:
    return CoreVectorEnv(build, num_envs, autoreset_mode=mode, render_mode=render)
