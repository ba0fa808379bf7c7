"""Environments in gymnasium's protocol: seeds, autoreset modes, and equal results of single and vector environments."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import offtrack.environments.registry
from offtrack.environments.core import Features, Observation
from offtrack.environments.registry import CoreVectorEnv
from offtrack.environments.rewards import Moment

TRAILER, DRIVING, ROVER = (f"offtrack/{name}" for name in offtrack.environments.registry.CORES)
EVERY: list[tuple[str, dict[str, Any]]] = [
    (TRAILER, {}),
    (TRAILER, {"observation": "truth"}),
    (DRIVING, {}),
    (DRIVING, {"task": "gate"}),
    (ROVER, {}),
]


def off_path(moment: Moment) -> Any:
    """Ending that random steering meets within seconds."""
    return np.abs(moment.off_tracking) > 0.03


def vector(name: str, n: int, **options: Any) -> CoreVectorEnv:
    """The environment without gymnasium's wrappers."""
    made = gymnasium.make_vec(name, num_envs=n, **options).unwrapped
    assert isinstance(made, CoreVectorEnv)
    return made


def features(observation: Observation) -> Features:
    """The observation of an environment without images."""
    assert isinstance(observation, np.ndarray)
    return observation


class ProtocolError(Exception):
    """A vector environment violates the protocol of its autoreset mode."""


def check_vector_env(make: Callable[[AutoresetMode], CoreVectorEnv], steps: int, seed: int = 0) -> int:
    """Check environments in each autoreset mode over random steps; return the number of ended episodes."""
    return sum(_checked(make(mode), mode, steps, seed) for mode in AutoresetMode)


def _checked(env: CoreVectorEnv, mode: AutoresetMode, steps: int, seed: int) -> int:
    try:
        _require(env.metadata.get("autoreset_mode") is mode, f"metadata names another mode than {mode}")
        _check_seeding(env, seed)
        return _check_steps(env, mode, steps, seed)
    finally:
        env.close()


def _check_seeding(env: CoreVectorEnv, seed: int) -> None:
    """A seed s gives sub-environment k the seed s + k, as a list of seeds does; None continues the generators."""
    first, info = env.reset(seed=seed)
    listed, _ = env.reset(seed=[seed + k for k in range(env.num_envs)])
    _require(np.array_equal(features(first), features(listed)), "a seed s is not s + k for sub-environment k")
    further, _ = env.reset()
    _require(
        not np.array_equal(features(first), features(further)), "a reset without a seed repeats the episode before"
    )
    _check_info(env, info)


def _check_steps(env: CoreVectorEnv, mode: AutoresetMode, steps: int, seed: int) -> int:
    env.action_space.seed(seed)
    env.reset(seed=seed)
    before, ended = np.zeros(env.num_envs, dtype=bool), 0
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        seen = features(observation)
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


def _check_shapes(env: CoreVectorEnv, seen: Any, reward: Any, terminated: Any, truncated: Any) -> None:
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


def _check_info(env: CoreVectorEnv, info: dict[str, Any]) -> None:
    """Every entry has a mask ``_name``."""
    for name in info:
        if not name.startswith("_"):
            _require(f"_{name}" in info, f"info has no _{name}")
            shape = np.shape(info[f"_{name}"])
            _require(shape == (env.num_envs,), f"info's _{name} has the shape {shape}")


def _check_final(env: CoreVectorEnv, seen: Features, done: NDArray[np.bool_], info: dict[str, Any]) -> None:
    for name in ("final_obs", "final_info"):
        _require(f"_{name}" in info and np.array_equal(info[f"_{name}"], done), f"info's _{name} is not who has ended")
    for lane in np.flatnonzero(done).tolist():
        last = info["final_obs"][lane]
        _require(last in env.single_observation_space, "a final observation is not in its space")
        _require(not np.array_equal(last, seen[lane]), "a new episode begins where the old one ended")


def _started_again(env: CoreVectorEnv, seen: Features, done: NDArray[np.bool_]) -> Features:
    """Reset the ended episodes; the others must not change."""
    again, _ = env.reset(options={"reset_mask": done})
    _require(np.array_equal(features(again)[~done], seen[~done]), "a reset of some has changed the others")
    return features(again)


def _require(condition: bool, complaint: str) -> None:
    if not condition:
        raise ProtocolError(complaint)


@pytest.mark.parametrize(("name", "options"), EVERY)
def test_gymnasiums_own_checker_has_nothing_to_complain_of(name: str, options: dict[str, Any]) -> None:
    """Warnings are errors here, so recommendations count too; the render check would need a screen."""
    check_env(gymnasium.make(name, **options).unwrapped, skip_render_check=True)


def test_vector_protocol_holds_in_every_mode_of_starting_again() -> None:
    """Random steering ends many episodes in these steps, so resets are tested."""

    def make(mode: AutoresetMode) -> CoreVectorEnv:
        return vector(TRAILER, 3, autoreset_mode=mode, endings={"off path": off_path})

    assert check_vector_env(make, 250) > 10


def test_protocol_checker_notices_a_wrong_mode() -> None:
    """The checker rejects an environment that resets in the same step but claims another mode."""

    def make(mode: AutoresetMode) -> CoreVectorEnv:
        made = vector(DRIVING, 2, autoreset_mode=AutoresetMode.SAME_STEP)
        made.metadata["autoreset_mode"] = mode
        made.core._time = 0.1  # type: ignore[attr-defined]  # episodes of five steps
        return made

    with pytest.raises(ProtocolError, match="starts again"):
        check_vector_env(make, 20)


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
    """The same seed and actions give the same numbers, also after another episode and in a pickled copy."""
    env = vector(name, 2)
    actions = np.random.default_rng(2).uniform(-1.0, 1.0, (30, *(env.action_space.shape or ()))).astype(np.float32)

    def episode(one: CoreVectorEnv) -> NDArray[np.float32]:
        return np.array([one.reset(seed=5)[0], *(one.step(action)[0] for action in actions)])

    first = episode(env)
    assert np.array_equal(episode(env), first)
    assert np.array_equal(episode(pickle.loads(pickle.dumps(env))), first)


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


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        (TRAILER, {"observation": "radar"}, "observation = 'radar' must be one of estimate, surrogate, truth, camera"),
        (TRAILER, {"vehicle": "eu_tractor_semitrailer"}, "steered axles"),
        (TRAILER, {"courses": ()}, "courses is empty"),
        (TRAILER, {"courses": ("random-x",)}, "random-K"),
        (TRAILER, {"cours": ()}, "unknown option 'cours'"),
        (DRIVING, {"task": "park"}, "task = 'park' must be one of bay, gate"),
        (ROVER, {"vehicle": "el_dorado_ii"}, "skid-steered"),
        (ROVER, {"soils": ("butter",)}, "butter"),
    ],
)
def test_wrong_options_are_refused_in_one_line(name: str, options: dict[str, Any], words: str) -> None:
    """Errors come when the environment is made, not during training."""
    with pytest.raises(ValueError, match=words) as error:
        gymnasium.make(name, **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"friktion": 0.3}, "did you mean 'friction'"),
        ({"friction": 7.0}, "within 0.05 .. 1.5"),
        ({"friction": "ice"}, "must be a number or two bounds"),
        ({"course": "moon"}, "course = moon must be one of roundabout"),
        ({"course": 99}, "or their number 0 .. 12"),
    ],
)
def test_wrong_reset_options_are_refused_in_one_line(options: dict[str, Any], words: str) -> None:
    """Reset options are checked when an episode begins."""
    with pytest.raises(ValueError, match=words):
        vector(TRAILER, 1).reset(options=options)


def test_reset_mask_must_fit() -> None:
    """A mask needs one boolean per environment, at least one of them True."""
    env = vector(DRIVING, 2)
    env.reset(seed=1)
    for mask in (np.array([True]), np.array([1, 0]), np.array([False, False])):
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})


@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_random_steps_stay_within_the_spaces_and_finite(name: str) -> None:
    """Any demand gives finite observations within their space and finite rewards, jackknifes included."""
    env = vector(name, 4)
    env.action_space.seed(1)
    env.reset(seed=1)
    for _ in range(300 if name != ROVER else 60):
        seen, reward, *_ = env.step(env.action_space.sample())
        assert seen in env.observation_space
        assert np.isfinite(reward).all()


def test_pictures_show_what_moves() -> None:
    """Pictures of two moments of an episode differ."""
    for name in (TRAILER, DRIVING, ROVER):
        env = gymnasium.make(name, render_mode="rgb_array", disable_env_checker=True)
        env.reset(seed=1)
        first = env.render()
        for _ in range(50):
            env.step(np.ones(env.action_space.shape or (), dtype=np.float32))
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
