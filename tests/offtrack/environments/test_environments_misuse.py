"""Environments that are copied in mid-episode, or called in a wrong order or with wrong values."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded

import offtrack  # noqa: F401  # registers the environments
from offtrack.environments.registry import single, vector
from offtrack.environments.rewards import Domain, follow_error
from scenarios.options.scenario import load_scenario
from tests.environments import DRIVING, ROVER, TRAILER, off_path

NAN, INF = float("nan"), float("inf")
COPIES: list[Callable[[Any], Any]] = [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]
KINDS: list[tuple[str, dict[str, Any]]] = [
    (TRAILER, {}),
    (DRIVING, {"engine": "interpreted"}),
    (TRAILER, {"action_repeat": 2}),
    (DRIVING, {}),
    (ROVER, {}),
    (ROVER, {"observation": "estimate"}),
]


same = np.testing.assert_equal  # bitwise


@pytest.mark.slow
@pytest.mark.parametrize("copied", COPIES, ids=["deepcopy", "pickle"])
@pytest.mark.parametrize(("name", "options"), KINDS)
def test_a_copy_continues_the_episode_bitwise(name: str, options: dict[str, Any], copied: Any) -> None:
    """Single environments: what the original does after the copy, the copy does too, also in the next episode."""
    env = single(name, **options)
    rng = np.random.default_rng(1)
    actions = rng.uniform(-0.3, 0.5, (12, 2)).astype(np.float32)
    env.reset(seed=3)
    for action in actions[:6]:
        env.step(action)
    twin = copied(env)
    original: list[Any] = [env.step(action) for action in actions[6:]]
    original.append((env.reset(), env.step(actions[0])))
    for expected, action in zip(original, actions[6:], strict=False):
        same(twin.step(action), expected)
    same((twin.reset(), twin.step(actions[0])), original[-1])


@pytest.mark.parametrize("copied", COPIES, ids=["deepcopy", "pickle"])
@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_a_copied_vector_environment_continues_bitwise(name: str, copied: Any) -> None:
    env = vector(name, 3, **({"endings": {"off path": off_path}} if name == TRAILER else {}))
    rng = np.random.default_rng(2)
    actions = rng.uniform(-1.0, 1.0, (160, *(env.action_space.shape or ()))).astype(np.float32)
    if name == ROVER:
        actions = actions[:25]
    env.reset(seed=3)
    for action in actions[:20]:
        env.step(action)
    twin = copied(env)
    for action in actions[20:]:
        same(twin.step(action), env.step(action))


@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_a_step_needs_a_reset_and_nothing_works_after_close(name: str) -> None:
    """The same errors for one and for many, gymnasium's own; a mask of the first reset leaves others unreset."""
    for env in (single(name, render_mode="rgb_array"), vector(name, 2, render_mode="rgb_array")):
        action = env.action_space.sample()
        with pytest.raises(ResetNeeded, match="step before reset"):
            env.step(action)
        if env.action_space.shape == (2, 2):
            env.reset(seed=1, options={"reset_mask": np.array([True, False])})
            with pytest.raises(ResetNeeded):
                env.step(action)
        env.reset(seed=1)
        env.step(action)
        env.close()
        env.close()
        for call in (env.reset, env.render, lambda env=env, action=action: env.step(action)):
            with pytest.raises(ClosedEnvironmentError, match="after close"):
                call()


WRONG_ACTIONS: list[tuple[Any, str]] = [
    ([0.0, NAN], r"\[1\] = nan must be a finite number"),
    (np.array([-INF, 0.0], dtype=np.float32), r"\[0\] = -inf must be a finite number"),
    ([0.0], r"of shape \(1,\) must be of shape \(2,\)"),
    *((wrong, "must be numbers of shape") for wrong in (None, "ab", [True, False], [0j, 1j], [[0.0], [0.0, 0.0]])),
    ([10**400, 0], "must be numbers of shape"),
]


@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_wrong_actions_are_refused_and_change_nothing(name: str) -> None:
    """A refused action leaves the episode as it was; of many, the number of the sub-environment is named."""
    env, untouched, many = single(name), single(name), vector(name, 3)
    for one in (env, untouched, many):
        one.reset(seed=1)
    for action, says in WRONG_ACTIONS:
        with pytest.raises(ValueError, match=rf"^[^\n]*{says}[^\n]*$"):
            env.step(action)
    same(env.step(np.zeros(2, np.float32)), untouched.step(np.zeros(2, np.float32)))
    with pytest.raises(ValueError, match=r"actions\[2, 1\] = nan must be a finite number"):
        many.step(np.array([[0.0, 0.0], [0.0, 0.0], [0.0, NAN]], np.float32))
    with pytest.raises(ValueError, match=r"actions of shape \(2,\) must be of shape \(3, 2\)"):
        many.step(np.zeros(2, np.float32))


def test_actions_of_other_types_and_beyond_the_limits_are_what_they_stand_for() -> None:
    """Lists, integers and 64-bit numbers are converted; beyond -1 .. 1 the demand is at its limit."""
    env, other = single(DRIVING), single(DRIVING)
    for one in (env, other):
        one.reset(seed=1)
    full = np.array([1.0, -1.0], dtype=np.float32)
    same_demand: list[Any] = [[1, -1], [1e300, -1e300], np.array([3.0, -2.0], np.float32), np.array([1, -1], np.int8)]
    for action in same_demand:
        same(other.step(action), env.step(full))


WRONG_OPTIONS: dict[str, list[tuple[Any, str]]] = {
    TRAILER: [
        ({"friktion": 0.3}, "did you mean 'friction'"),
        ({"course": "moon"}, "course = moon must be one of roundabout"),
        ({"course": True}, "course = True must be one of roundabout"),
        ({"course": ("roundabout",)}, r"course = \('roundabout',\) must be one of"),
        ({"course": ["x" * 500]}, "course = "),
        ({"friction": True}, "friction = True must be a number or two bounds"),
        ({"friction": 10**400}, "within 0.05 .. 1.5"),
        ({"friction": "ic"}, "friction = 'ic' must be a number or two bounds"),
        ({"friction": (0.9, 0.2)}, "must be a range within"),
    ],
    DRIVING: [
        ({"course": "roundabout"}, "unknown reset option 'course'"),
        ({1: 2}, "must be a dictionary of reset options by name"),
    ],
    ROVER: [
        ({"soil": ["beach_sand"]}, r"soil = \['beach_sand'\] must be one of"),
        ({"speed": {}}, "speed = {} must be a number or two bounds"),
    ],
}


@pytest.mark.parametrize("name", [TRAILER, DRIVING, ROVER])
def test_wrong_reset_options_are_named(name: str) -> None:
    env = single(name)
    for options, says in WRONG_OPTIONS[name]:
        with pytest.raises(ValueError, match=says) as error:
            env.reset(options=options)
        assert "\n" not in str(error.value)
        assert len(str(error.value)) < 400
    env.reset(seed=1)


def test_wrong_seeds_are_named() -> None:
    env, many = single(DRIVING), vector(DRIVING, 2)
    wrong: list[Any] = [-1, True, 1.5, NAN, "1", {}]
    for seed in wrong:
        for call in (lambda seed=seed: env.reset(seed=seed), lambda seed=seed: many.reset(seed=[1, seed])):
            with pytest.raises(ValueError, match=r"seed = .* must be a whole number >= 0"):
                call()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: vector(DRIVING, 0), "num_envs = 0 must be a whole number"),
        (lambda: vector(DRIVING, 10**9), "num_envs = 1000000000 must be .* at most 65536"),
        (lambda: vector(DRIVING, True), "num_envs = True must be a whole number"),
        (lambda: vector(DRIVING, autoreset_mode="Never"), "autoreset_mode = 'Never' must be one of NextStep, SameStep"),
        (lambda: single(TRAILER, action_repeat=1.5), "action_repeat = 1.5 must be a whole number"),
        (lambda: single(TRAILER, action_repeat=10**9), "action_repeat = 1000000000 must be .* at most 1000"),
        (lambda: single("TrailerStearing-v0"), "unknown environment 'TrailerStearing-v0'; did you mean 'TrailerSteer"),
        (lambda: single(TRAILER, vehicle=3), "vehicle = 3 must be a text"),
        (lambda: single(TRAILER, vehicle="eu_tractor_semitrailer"), "steered axles"),
        (lambda: single(TRAILER, courses=()), "courses is empty"),
        (lambda: single(TRAILER, courses=("random-x",)), "random-K"),
        (lambda: single(TRAILER, cours=()), "unknown key 'cours'; did you mean 'courses'"),
        (lambda: single(DRIVING, task="park"), "task = 'park'; known: bay, gate"),
        (lambda: single(ROVER, vehicle="el_dorado_ii"), "skid-steered"),
        (lambda: single(ROVER, soils=("butter",)), "butter"),
        (lambda: single(TRAILER, courses="roundabout"), "courses = 'roundabout'"),
        (lambda: single(TRAILER, courses=["motorway-exit"]), "course motorway-exit: its file has heights, banks"),
        (lambda: single(TRAILER, domain={"friction": 0.3}), "domain = .* must be an instance of Domain"),
        (lambda: single(TRAILER, reward={follow_error: NAN}), "reward = .*: must be a finite number"),
        (lambda: single(TRAILER, sensing=5, observation="estimate"), "sensing = 5"),
        (lambda: single(TRAILER, image_scale=True, observation="camera"), "image_scale = True"),
        (lambda: single(TRAILER, observation="camera", image_scale=0), "image_scale = 0 must be 1 .. 48"),
        (lambda: single(TRAILER, observation="camera", sensing="rover-slope"), "rover-slope is a rover's"),
        (lambda: single(ROVER, observation="camera", sensing="roundabout"), "roundabout is a trailer's"),
        (lambda: single(ROVER, observation="estimate", soils=("none",)), "firm ground takes no trace"),
        *(
            (lambda key=key: single(TRAILER, observation="estimate", sensing=load_scenario("roundabout", [key])), line)
            for key, line in (
                ("off_tracking=truth", "use observation = 'truth'"),
                ("off_tracking=surrogate", "use observation = 'surrogate'"),
                ("rig.rate_hz=8", "multiple of the control step, 0.02 s"),
            )
        ),
        (lambda: single(ROVER, engine="steam"), "engine = 'steam'; known: auto, compiled, interpreted"),
        (lambda: single(ROVER, observation=2), "observation = 2 must be estimate, surrogate, truth, camera"),
        (lambda: Domain(friction=0.3), "friction = .* must be a number or two bounds"),  # type: ignore[arg-type]
        (lambda: Domain(speed=(NAN, 3.0)), "speed = nan .. 3 must be a range"),
    ],
)
def test_wrong_constructor_arguments_are_named(make: Callable[[], Any], says: str) -> None:
    with pytest.raises(ValueError, match=says) as error:
        make()
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_the_adapter_for_stable_baselines_refuses_the_same() -> None:
    """Actions pass through the vector environment; a copy in mid-episode continues."""
    pytest.importorskip("stable_baselines3", reason="the extra rl is not installed: pip install 'offtrack[rl]'")
    from offtrack.environments.sb3 import sb3_vector

    env = sb3_vector(TRAILER, 2)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((2, 2), np.float32))
    env.reset()
    with pytest.raises(ValueError, match=r"actions\[0, 1\] = nan must be a finite number"):
        env.step(np.array([[0.0, NAN], [0.0, 0.0]], np.float32))
    twin = pickle.loads(pickle.dumps(env))
    for _ in range(12):
        same(twin.step(np.full((2, 2), 0.4, np.float32)), env.step(np.full((2, 2), 0.4, np.float32)))
    with pytest.raises(ValueError, match="reward_scale = nan must be a finite number"):
        sb3_vector(TRAILER, 2, reward_scale=NAN)
