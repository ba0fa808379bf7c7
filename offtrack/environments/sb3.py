"""Vector environments for stable-baselines3: one object for all sub-environments.

    from stable_baselines3 import PPO
    from offtrack.environments.sb3 import sb3_vector

    PPO("MlpPolicy", sb3_vector("TrailerSteering-v0", 256, action_repeat=4)).learn(100_000)

Requires the extra ``rl``.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from offtrack.environments import registry
from offtrack.environments.core import Observation
from offtrack.environments.registry import CoreVectorEnv
from offtrack.reports.canvas import Picture

try:
    import torch as _torch  # noqa: F401  # stable-baselines3's own error does not say where to get it
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(f"{error}: pip install 'offtrack[rl]', which brings stable-baselines3 and torch") from error

Indices = int | Iterable[int] | None


def sb3_vector(name: str, num_envs: int, *, reward_scale: float = 1.0, **options: Any) -> "Sb3VecEnv":
    """``num_envs`` environments of this name (``TrailerSteering-v0`` …) with its options.

    Raises:
        ValueError: one line, if an option is unknown or does not fit.
    """
    made = registry.vector(name, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **options)
    return Sb3VecEnv(made, reward_scale=reward_scale)


class Sb3VecEnv(VecEnv):  # type: ignore[misc]  # untyped: the extra may not be installed
    """A native vector environment with stable-baselines3's interface.

    ``info`` of a sub-environment is empty unless its episode has ended. Then it holds ``terminal_observation``,
    ``TimeLimit.truncated``, the episode's metrics and ``outcome``, and ``episode`` (r: return, l: steps) as in
    monitors. All sub-environments share one object, so attributes are those of the vector environment.
    """

    def __init__(self, env: CoreVectorEnv, *, reward_scale: float = 1.0) -> None:
        """Wrap an environment that resets in the same step; rewards are scaled, except in ``episode``.

        Raises:
            ValueError: one line, if it resets in another mode, or the scale is not a finite number.
        """
        if isinstance(reward_scale, bool) or not math.isfinite(reward_scale):
            raise ValueError(f"reward_scale = {reward_scale} must be a finite number")
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise ValueError("stable-baselines3 needs environments with autoreset_mode = AutoresetMode.SAME_STEP")
        self.env, self._reward_scale = env, reward_scale
        self._actions = np.zeros(env.action_space.shape or (), dtype=np.float32)
        self._return, self._length = np.zeros(env.num_envs), np.zeros(env.num_envs, dtype=np.intp)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> Observation:
        """Begin all episodes, with the seeds and options of ``seed`` and ``set_options``."""
        for options, mask in _groups(self._options):
            observation, info = self.env.reset(seed=self._seeds, options={**options, "reset_mask": mask})
            for lane in np.flatnonzero(mask).tolist():
                self.reset_infos[lane] = _of_lane(info, lane)
        self._reset_seeds()
        self._reset_options()
        self._return[:], self._length[:] = 0.0, 0
        return observation

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the actions (num_envs, n_action) for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance all: observations, rewards, ended episodes (n,), and infos."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        self._return += reward
        self._length += 1
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for lane in np.flatnonzero(done).tolist():
            episode = {"r": float(self._return[lane]), "l": int(self._length[lane])}
            infos[lane] = {
                **_of_lane(info["final_info"], lane),
                "terminal_observation": info["final_obs"][lane],
                "TimeLimit.truncated": bool(truncated[lane]),
                "episode": episode,
            }
        self._return[done], self._length[done] = 0.0, 0
        return observation, (self._reward_scale * reward).astype(np.float32), done, infos

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def get_images(self) -> Sequence[Picture]:
        """Top view of every episode."""
        return self.env.render() or ()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """The vector environment's attribute, once per requested sub-environment."""
        return [getattr(self.env, attr_name)] * len(self._requested(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set the vector environment's attribute, for all at once.

        Raises:
            ValueError: if only some are requested.
        """
        self._require_all(f"attribute {attr_name}", indices)
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call the vector environment's method once; its result counts for every sub-environment.

        Raises:
            ValueError: if only some are requested.
        """
        self._require_all(f"method {method_name}", indices)
        return [getattr(self.env, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """False: there are no wrappers."""
        return [False] * len(self._requested(indices))

    def _requested(self, indices: Indices) -> list[int]:
        return list(self._get_indices(indices))

    def _require_all(self, what: str, indices: Indices) -> None:
        if len(self._requested(indices)) != self.num_envs:
            raise ValueError(f"{what}: these environments are one object: request all of them, without indices")


def _groups(options: Sequence[dict[str, Any]]) -> list[tuple[dict[str, Any], NDArray[np.bool_]]]:
    """Distinct options, each with a mask (n,) of its sub-environments."""
    groups: list[tuple[dict[str, Any], NDArray[np.bool_]]] = []
    for lane, given in enumerate(options):
        for known, mask in groups:
            if known == given:
                mask[lane] = True
                break
        else:
            groups.append((given, np.arange(len(options)) == lane))
    return groups


def _of_lane(info: dict[str, Any], lane: int) -> dict[str, Any]:
    """Info of one sub-environment."""
    return {
        name: values[lane].item() if isinstance(values[lane], np.generic) else values[lane]
        for name, values in info.items()
        if not name.startswith("_") and info[f"_{name}"][lane]
    }
