"""Environments in gymnasium's protocol: seeds, autoreset modes, and equal results of single and vector environments."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import offtrack.environments.registry
from offtrack.environments.core import Features
from offtrack.environments.registry import CoreVectorEnv
from tests.environments import features, off_path

TRAILER, DRIVING, ROVER = (f"offtrack/{name}" for name in offtrack.environments.registry.CORES)
EVERY: list[tuple[str, dict[str, Any]]] = [
    *((name, {}) for name in (TRAILER, DRIVING, ROVER)),
    *((TRAILER, {"observation": "truth"}), (DRIVING, {"task": "gate"})),
]


def vector(name: str, n: int, **options: Any) -> CoreVectorEnv:
    made = gymnasium.make_vec(name, num_envs=n, **options).unwrapped
    assert isinstance(made, CoreVectorEnv)
    return made


def ended_episodes(env: CoreVectorEnv, mode: AutoresetMode, steps: int) -> int:
    """Check an environment in an autoreset mode over random steps; return the number of ended episodes."""
    assert env.metadata["autoreset_mode"] is mode
    check_seeding(env, 0)
    env.action_space.seed(0)
    env.reset(seed=0)
    before, ended = np.zeros(env.num_envs, dtype=bool), 0
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        seen, done = features(observation), terminated | truncated
        assert seen in env.observation_space
        for array, kind in ((reward, np.floating), (terminated, np.bool_), (truncated, np.bool_)):
            assert array.shape == (env.num_envs,)
            assert np.issubdtype(array.dtype, kind)
        assert np.isfinite(reward).all()
        assert not (terminated & truncated).any()
        check_info(env, info)
        if mode is AutoresetMode.NEXT_STEP:  # a step that starts again has no result
            assert not (done & before).any()
            assert not reward[before].any()
        if mode is AutoresetMode.SAME_STEP and done.any():
            check_final(env, seen, done, info)
        if mode is AutoresetMode.DISABLED and done.any():  # a reset of some leaves the others
            again = features(env.reset(options={"reset_mask": done})[0])
            assert np.array_equal(again[~done], seen[~done])
        ended, before = ended + int(done.sum()), done
    return ended


def check_seeding(env: CoreVectorEnv, seed: int) -> None:
    """A seed s gives sub-environment k the seed s + k, as a list of seeds does; None continues the generators."""
    first, info = env.reset(seed=seed)
    listed, _ = env.reset(seed=[seed + k for k in range(env.num_envs)])
    assert np.array_equal(features(first), features(listed))
    assert not np.array_equal(features(first), features(env.reset()[0]))
    check_info(env, info)


def check_info(env: CoreVectorEnv, info: dict[str, Any]) -> None:
    for name in info:
        assert name.startswith("_") or np.shape(info[f"_{name}"]) == (env.num_envs,)


def check_final(env: CoreVectorEnv, seen: Features, done: NDArray[np.bool_], info: dict[str, Any]) -> None:
    """The last observation of an episode is in its space, and a new episode does not begin with it."""
    for name in ("final_obs", "final_info"):
        assert np.array_equal(info[f"_{name}"], done)
    for lane in np.flatnonzero(done).tolist():
        assert info["final_obs"][lane] in env.single_observation_space
        assert not np.array_equal(info["final_obs"][lane], seen[lane])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), EVERY)
def test_gymnasiums_own_checker_has_nothing_to_complain_of(name: str, options: dict[str, Any]) -> None:
    """Warnings are errors here, so recommendations count too; the render check would need a screen."""
    check_env(gymnasium.make(name, **options).unwrapped, skip_render_check=True)


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_vector_protocol_holds_in_every_mode_of_starting_again(mode: AutoresetMode) -> None:
    """Random steering ends many episodes in these steps, so resets are tested."""
    env = vector(TRAILER, 3, autoreset_mode=mode, endings={"off path": off_path})
    assert ended_episodes(env, mode, 250) > 3
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), EVERY)
def test_many_do_what_single_ones_do(name: str, options: dict[str, Any]) -> None:
    """Sub-environment k of a vector seeded with s is a single environment seeded with s + k; they differ in rounding.

    Compiled for one and for many, sums are rounded differently: 1e-5 of an observation in 32 bits is a hundred of them.
    """
    n, steps = 3, 40
    many = vector(name, n, **options)
    actions = (
        np.random.default_rng(1)
        .uniform(-1.0, 1.0, (steps, n, *(many.single_action_space.shape or ())))
        .astype(np.float32)
    )
    seen, rewards = [features(many.reset(seed=7)[0])], []
    for action in actions:
        observation, reward, *_ = many.step(action)
        seen.append(features(observation))
        rewards.append(reward)
    for k in range(n):
        one = gymnasium.make(name, disable_env_checker=True, **options)
        assert one.reset(seed=7 + k)[0] == pytest.approx(seen[0][k], rel=1e-5, abs=1e-5)
        for step in range(steps):
            single, its_reward, *_ = one.step(actions[step, k])
            assert single == pytest.approx(seen[step + 1][k], rel=1e-5, abs=1e-5)
            assert its_reward == pytest.approx(rewards[step][k], rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_a_seed_decides_the_whole_episode_bitwise(name: str) -> None:
    env = vector(name, 2)
    actions = np.random.default_rng(2).uniform(-1.0, 1.0, (30, *(env.action_space.shape or ()))).astype(np.float32)

    def episode(one: CoreVectorEnv) -> NDArray[np.float32]:
        return np.array([one.reset(seed=5)[0], *(one.step(action)[0] for action in actions)])

    first = episode(env)
    assert np.array_equal(episode(env), first)
    assert np.array_equal(episode(pickle.loads(pickle.dumps(env))), first)


@pytest.mark.slow
def test_who_starts_again_leaves_the_others_as_they_would_have_been() -> None:
    """An episode's numbers depend on its own generator alone."""
    still, ending = (vector(TRAILER, 2, autoreset_mode=AutoresetMode.DISABLED) for _ in range(2))
    for env in (still, ending):
        env.reset(seed=3)
    action = np.zeros(still.action_space.shape or (), dtype=np.float32)
    for step in range(60):
        left, right = features(still.step(action)[0]), features(ending.step(action)[0])
        assert np.array_equal(left[0], right[0])
        if step == 20:
            ending.reset(options={"reset_mask": np.array([False, True])})
    assert not np.array_equal(left[1], right[1])


@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_pictures_show_what_moves_and_random_steps_stay_finite(name: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array", disable_env_checker=True)
    env.action_space.seed(1)
    env.reset(seed=1)
    first = env.render()
    for _ in range(60 if name == ROVER else 300):
        seen, reward, ended, *_ = env.step(env.action_space.sample())
        assert seen in env.observation_space
        assert np.isfinite(float(reward))
        if ended:
            break
    second = env.render()
    assert isinstance(first, np.ndarray)
    assert isinstance(second, np.ndarray)
    assert first.shape == (600, 600, 3)
    assert not np.array_equal(first, second)


def test_a_broken_state_ends_its_own_episode_and_nothing_else() -> None:
    """An episode with diverged physics ends with finite numbers and restarts; its neighbours are unaffected."""
    broken, whole = (vector(TRAILER, 3) for _ in range(2))
    action = np.zeros(whole.action_space.shape or (), dtype=np.float32)
    for env in (broken, whole):
        env.reset(seed=4)
        env.step(action)
    broken.core._fleet._state[1] = np.nan  # type: ignore[attr-defined]
    for step in range(3):
        seen, reward, terminated, _, info = broken.step(action)
        expected, *_ = whole.step(action)
        assert seen in broken.observation_space
        assert np.isfinite(reward).all()
        assert terminated.tolist() == [False, step == 0, False]
        assert np.array_equal(features(seen)[[0, 2]], features(expected)[[0, 2]])
        if step == 0:
            assert info["outcome"][1] == "diverged"
    assert np.isfinite(broken.core._fleet._state).all()  # type: ignore[attr-defined]
