"""A checker of gymnasium's protocol for vector environments, in every mode of starting again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

Vector = VectorEnv[Any, Any, Any]


class ProtocolError(Exception):
    """A vector environment does not do what its mode says."""


def check_vector_env(make: Callable[[AutoresetMode], Vector], steps: int, seed: int = 0) -> int:
    """Checks environments made for each mode over so many random steps; returns how many episodes ended in them.

    Raises:
        ProtocolError: one line, about the first thing wrong.
    """
    return sum(_checked(make(mode), mode, steps, seed) for mode in AutoresetMode)


def _checked(env: Vector, mode: AutoresetMode, steps: int, seed: int) -> int:
    try:
        _require(env.metadata.get("autoreset_mode") is mode, f"metadata names another mode than {mode}")
        _check_seeding(env, seed)
        return _check_steps(env, mode, steps, seed)
    finally:
        env.close()


def _check_seeding(env: Vector, seed: int) -> None:
    """A seed s gives sub-environment k the seed s + k, as a list of seeds would; None goes on with what there is."""
    first, info = env.reset(seed=seed)
    listed, _ = env.reset(seed=[seed + k for k in range(env.num_envs)])  # type: ignore[arg-type]  # its own ones take lists too
    _require(np.array_equal(first, listed), "a seed s is not s + k for sub-environment k")
    further, _ = env.reset()
    _require(not np.array_equal(first, further), "a reset without a seed repeats the episode before")
    _check_info(env, info)


def _check_steps(env: Vector, mode: AutoresetMode, steps: int, seed: int) -> int:
    env.action_space.seed(seed)
    env.reset(seed=seed)
    before, ended = np.zeros(env.num_envs, dtype=bool), 0
    for _ in range(steps):
        seen, reward, terminated, truncated, info = env.step(env.action_space.sample())
        _check_shapes(env, seen, reward, terminated, truncated)
        _check_info(env, info)
        done = terminated | truncated
        if mode is AutoresetMode.NEXT_STEP:
            _require(not (done & before).any() and not reward[before].any(), "a step that starts again has a result")
        if mode is AutoresetMode.SAME_STEP and done.any():
            _check_final(env, seen, done, info)
        if mode is AutoresetMode.DISABLED and done.any():
            seen = _started_again(env, seen, done)
        ended += int(done.sum())
        before = done
    return ended


def _check_shapes(env: Vector, seen: Any, reward: Any, terminated: Any, truncated: Any) -> None:
    _require(seen in env.observation_space, "an observation is not in its space")
    for name, array, kind in (
        ("reward", reward, np.floating),
        ("terminated", terminated, np.bool_),
        ("truncated", truncated, np.bool_),
    ):
        _require(array.shape == (env.num_envs,), f"{name} has the shape {array.shape}")
        _require(np.issubdtype(array.dtype, kind), f"{name} has the type {array.dtype}")
    _require(bool(np.isfinite(reward).all()), "a reward is not finite")
    _require(not (terminated & truncated).any(), "an episode is both terminated and truncated")


def _check_info(env: Vector, info: dict[str, Any]) -> None:
    """Every entry has beside it whose it is."""
    for name in info:
        if not name.startswith("_"):
            _require(f"_{name}" in info, f"info has no _{name}")
            shape = np.shape(info[f"_{name}"])
            _require(shape == (env.num_envs,), f"info's _{name} has the shape {shape}")


def _check_final(env: Vector, seen: NDArray[Any], done: NDArray[np.bool_], info: dict[str, Any]) -> None:
    for name in ("final_obs", "final_info"):
        _require(f"_{name}" in info and np.array_equal(info[f"_{name}"], done), f"info's _{name} is not who has ended")
    for lane in np.flatnonzero(done).tolist():
        last = info["final_obs"][lane]
        _require(last in env.single_observation_space, "a final observation is not in its space")
        _require(not np.array_equal(last, seen[lane]), "a new episode begins where the old one ended")


def _started_again(env: Vector, seen: NDArray[Any], done: NDArray[np.bool_]) -> NDArray[Any]:
    """A reset of those that have ended leaves the others as they are."""
    again, _ = env.reset(options={"reset_mask": done})
    _require(np.array_equal(again[~done], seen[~done]), "a reset of some has changed the others")
    return np.asarray(again)


def _require(condition: bool, complaint: str) -> None:
    if not condition:
        raise ProtocolError(complaint)
