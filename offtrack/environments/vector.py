"""Many episodes as a gymnasium vector environment, in all autoreset modes."""

from __future__ import annotations

import copyreg
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from offtrack.environments.core import (
    MAX_ENVS,
    Core,
    Info,
    Observation,
    Result,
    call_error,
    checked_actions,
    checked_count,
    checked_seed,
    of_lane,
    reset_options,
)
from offtrack.reports.canvas import Picture

Flags = NDArray[np.bool_]
_StepResult = tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]


class CoreVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Environment around a core of many episodes; sub-environment k equals a single one with seed s + k.

    Copies are as those of a single one: exact in mid-episode, built anew before the first reset.
    """

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
        num_envs = checked_count("num_envs", num_envs, MAX_ENVS)
        if autoreset_mode not in list(AutoresetMode) + [mode.value for mode in AutoresetMode]:
            modes = ", ".join(mode.value for mode in AutoresetMode)
            raise ValueError(f"autoreset_mode = {autoreset_mode!r:.80} must be one of {modes}")
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
        self._shape = (num_envs, *self.single_action_space.shape)
        self._generators: list[np.random.Generator] = []
        self._begun, self._done = np.zeros(num_envs, dtype=bool), np.zeros(num_envs, dtype=bool)
        self._open = False  # all episodes have begun, and the environment is not closed

    def __reduce__(self) -> tuple[Any, ...]:
        if self.closed or not self._begun.any():
            return (_again, self._arguments)  # without an episode there is nothing else to copy
        return (copyreg.__newobj__, (type(self),), vars(self))  # type: ignore[attr-defined]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes in all sub-environments, or in those of ``options["reset_mask"]``.

        Raises:
            ValueError: one line, if a seed, the mask or an option is wrong.
            ClosedEnvironmentError: after ``close``.
        """
        if self.closed:
            raise call_error("reset", closed=True)
        given = reset_options(options)
        mask = np.asarray(given.pop("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"reset_mask must be {self.num_envs} booleans, at least one of them True")
        self._seed(seed, mask)
        self._begin(mask, given)
        return self.core.observe(), self._masked(self.core.info(), mask)

    def step(self, actions: NDArray[np.float32]) -> _StepResult:
        """Advance all by a control step; ended episodes restart according to the autoreset mode.

        Raises:
            ValueError: one line, if the actions are not finite numbers (num_envs, n_action).
            ResetNeeded: before the first ``reset`` of all sub-environments.
            ClosedEnvironmentError: after ``close``.
        """
        if not self._open:
            raise call_error("step", closed=self.closed)
        result = self.core.step(checked_actions(actions, self._shape))
        if self._mode is AutoresetMode.NEXT_STEP:
            return self._after(self._restarted(result))
        if self._mode is AutoresetMode.SAME_STEP:
            return self._same_step(result)
        return self._after(result)

    def render(self) -> tuple[Picture, ...] | None:
        """Top view of every episode, for ``rgb_array``.

        Raises:
            ClosedEnvironmentError: after ``close``.
        """
        if self.closed:
            raise call_error("render", closed=True)
        if self.render_mode != "rgb_array":
            return None
        return tuple(self.core.picture(lane) for lane in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close cameras."""
        self._open = False
        self.core.close()

    def _seed(self, seed: Any, mask: Flags) -> None:
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
            seeds = [checked_seed(one) for one in seed]
        else:
            first = checked_seed(seed)
            seeds = [None if first is None else first + k for k in range(self.num_envs)]
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
        self._done[mask], self._begun[mask] = False, True
        self._open = self._open or bool(self._begun.all())

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
