"""Environments as gymnasium wants them: protocol, seeds, modes of starting again, the same for one and for many."""

from __future__ import annotations

import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import scenarios.gym_env
from scenarios.environments.checker import ProtocolError, check_vector_env
from scenarios.environments.moment import Moment
from scenarios.environments.vector import CoreVectorEnv

TRAILER, DRIVING, ROVER = (f"offtrack/{name}" for name in scenarios.gym_env.CORES)
EVERY: list[tuple[str, dict[str, Any]]] = [
    (TRAILER, {}),
    (TRAILER, {"observation": "truth"}),
    (DRIVING, {}),
    (DRIVING, {"task": "gate"}),
    (ROVER, {}),
]


def beside(moment: Moment) -> Any:
    """An end that random steering meets within seconds."""
    return np.abs(moment.off_tracking) > 0.03


def vector(name: str, n: int, **options: Any) -> CoreVectorEnv:
    """The environment without what gymnasium wraps around it."""
    made = gymnasium.make_vec(name, num_envs=n, **options).unwrapped
    assert isinstance(made, CoreVectorEnv)
    return made


@pytest.mark.parametrize(("name", "options"), EVERY)
def test_gymnasiums_own_checker_has_nothing_to_complain_of(name: str, options: dict[str, Any]) -> None:
    """Warnings are errors here, so its recommendations count too; its look at a window needs a screen."""
    check_env(gymnasium.make(name, **options).unwrapped, skip_render_check=True)


def test_vector_protocol_holds_in_every_mode_of_starting_again() -> None:
    """Random steering ends many episodes in these steps, so that starting again is what is looked at."""

    def make(mode: AutoresetMode) -> CoreVectorEnv:
        return vector(TRAILER, 3, autoreset_mode=mode, endings={"beside": beside})

    assert check_vector_env(make, 250) > 10


def test_protocol_checker_notices_a_wrong_mode() -> None:
    """An environment that starts again in the same step is none that does so in the next one."""

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
        np.random.default_rng(1).uniform(-1.0, 1.0, (steps, n, *many.single_action_space.shape)).astype(np.float32)
    )
    seen = [many.reset(seed=7)[0]]
    rewards = []
    for action in actions:
        observation, reward, *_ = many.step(action)
        seen.append(observation)
        rewards.append(reward)
    for k in range(n):
        one = gymnasium.make(name, disable_env_checker=True, **options)
        assert one.reset(seed=7 + k)[0] == pytest.approx(seen[0][k], rel=1e-5, abs=1e-5)
        for step in range(steps):
            observation, reward, *_ = one.step(actions[step, k])
            assert observation == pytest.approx(seen[step + 1][k], rel=1e-5, abs=1e-5)
            assert reward == pytest.approx(rewards[step][k], rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_a_seed_decides_the_whole_episode_bitwise(name: str) -> None:
    """The same seed and actions give the same numbers, also after another episode and in a pickled copy."""
    env = vector(name, 2)
    actions = np.random.default_rng(2).uniform(-1.0, 1.0, (30, *env.action_space.shape)).astype(np.float32)

    def episode(one: CoreVectorEnv) -> np.ndarray[Any, Any]:
        return np.array([one.reset(seed=5)[0], *(one.step(action)[0] for action in actions)])

    first = episode(env)
    assert np.array_equal(episode(env), first)
    assert np.array_equal(episode(pickle.loads(pickle.dumps(env))), first)


def test_who_starts_again_leaves_the_others_as_they_would_have_been() -> None:
    """An episode's numbers depend on its own generator alone."""
    still, ending = (vector(TRAILER, 2, autoreset_mode=AutoresetMode.DISABLED) for _ in range(2))
    for env in (still, ending):
        env.reset(seed=3)
    action = np.zeros(still.action_space.shape, dtype=np.float32)
    for step in range(60):
        left, right = still.step(action)[0], ending.step(action)[0]
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
def test_wrong_options_are_told_in_one_line(name: str, options: dict[str, Any], words: str) -> None:
    """When the environment is made, not in the middle of a night's training."""
    with pytest.raises(ValueError, match=words) as error:
        gymnasium.make(name, **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"friktion": 0.3}, "did you mean 'friction'"),
        ({"friction": 7.0}, "within 0.05 .. 1.5"),
        ({"friction": "ice"}, "must be a number, or two"),
        ({"course": "moon"}, "is none of"),
        ({"course": 99}, "must be 0 .. 12"),
    ],
)
def test_wrong_reset_options_are_told_in_one_line(options: dict[str, Any], words: str) -> None:
    """The same of what an episode is begun with."""
    with pytest.raises(ValueError, match=words):
        vector(TRAILER, 1).reset(options=options)


def test_reset_mask_must_fit() -> None:
    """One boolean for each, and one of them at least."""
    env = vector(DRIVING, 2)
    env.reset(seed=1)
    for mask in (np.array([True]), np.array([1, 0]), np.array([False, False])):
        with pytest.raises(ValueError, match="reset_mask"):
            env.reset(options={"reset_mask": mask})


@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_random_steps_stay_within_the_spaces_and_finite(name: str) -> None:
    """Whatever is demanded: every number of observation and reward is one, jackknifes included."""
    env = vector(name, 4)
    env.action_space.seed(1)
    env.reset(seed=1)
    for _ in range(300 if name != ROVER else 60):
        seen, reward, *_ = env.step(env.action_space.sample())
        assert seen in env.observation_space
        assert np.isfinite(reward).all()


def test_pictures_show_what_moves() -> None:
    """Two moments of an episode do not look alike."""
    for name in (TRAILER, DRIVING, ROVER):
        env = gymnasium.make(name, render_mode="rgb_array", disable_env_checker=True)
        env.reset(seed=1)
        first = env.render()
        for _ in range(50):
            env.step(np.ones(env.action_space.shape, dtype=np.float32))
        second = env.render()
        assert isinstance(first, np.ndarray)
        assert first.shape == (600, 600, 3)
        assert not np.array_equal(first, second)


def test_a_broken_state_ends_its_own_episode_and_nothing_else() -> None:
    """One whose physics broke is terminated with finite numbers, and begins anew; its neighbours do not notice."""
    broken, whole = (vector(TRAILER, 3) for _ in range(2))
    action = np.zeros(whole.action_space.shape, dtype=np.float32)
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
        assert np.array_equal(seen[[0, 2]], expected[[0, 2]])
        if step == 0:
            assert info["outcome"][1] == "diverged"
    assert np.isfinite(broken.core._fleet._state).all()  # type: ignore[attr-defined]
