"""Environments in gymnasium's protocol: seeds, autoreset modes, one and many; copies, wrong order and wrong values."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import offtrack  # registers the environments
import offtrack.environments.registry
from offtrack.environments.core import Features
from offtrack.environments.registry import CoreVectorEnv, single
from offtrack.environments.registry import vector as many_of
from offtrack.environments.rewards import Domain, follow_error
from scenarios.options.scenario import load_scenario
from tests.environments import features, off_path

STEERING, DOCKING, SANDY = offtrack.environments.registry.CORES
TRAILER, DRIVING, ROVER = (f"offtrack/{name}" for name in offtrack.environments.registry.CORES)
EVERY: list[tuple[str, dict[str, Any]]] = [
    *((name, {}) for name in (TRAILER, DRIVING, ROVER)),
    *((TRAILER, {"observation": "truth"}), (DRIVING, {"task": "gate"})),
    *((TRAILER, {"road_width": 8.0}), (DRIVING, {"task": "road", "courses": ("roundabout", "turn-90")})),
]


def vector(name: str, n: int, **options: Any) -> CoreVectorEnv:
    made = gymnasium.make_vec(name, num_envs=n, **options).unwrapped
    assert isinstance(made, CoreVectorEnv)
    return made


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("repeat", [1, 3])
def test_a_vector_environment_cuts_episodes_as_gymnasium_does(mode: AutoresetMode, repeat: int) -> None:
    """After 5 actions, also of several control steps; a single one made with the same limit does the same."""
    env = vector(TRAILER, 3, max_episode_steps=5, autoreset_mode=mode, action_repeat=repeat)
    single = gymnasium.make(TRAILER, max_episode_steps=5, action_repeat=repeat)
    env.reset(seed=4)
    single.reset(seed=4)
    action = np.zeros((3, 2), dtype=np.float32)
    for k in range(1, 6):
        _, _, terminated, truncated, info = env.step(action)
        assert truncated.tolist() == [k == 5] * 3
        assert single.step(action[0])[3] == truncated[0]
        assert not terminated.any()
    assert info.get("final_info", info)["outcome"].tolist() == ["timed out"] * 3
    if mode is AutoresetMode.DISABLED:
        env.reset(options={"reset_mask": np.array([True, False, False])})
        assert env.step(action)[3].tolist() == [False, True, True]
    else:
        lasts = [bool(env.step(action)[3].all()) for _ in range(6)]
        assert lasts.index(True) == (5 if mode is AutoresetMode.NEXT_STEP else 4)  # one starts it again
    single.close()
    env.close()


def test_a_limit_of_steps_is_checked() -> None:
    with pytest.raises(ValueError, match="max_episode_steps = 0 must be a whole number, at least 1"):
        vector(TRAILER, 2, max_episode_steps=0)


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


@pytest.mark.parametrize("name", [DRIVING, *(pytest.param(name, marks=pytest.mark.slow) for name in (TRAILER, ROVER))])
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


NAN, INF = float("nan"), float("inf")
COPIES: list[Callable[[Any], Any]] = [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))]
KINDS: list[tuple[str, dict[str, Any]]] = [
    (STEERING, {}),
    (DOCKING, {"engine": "interpreted"}),
    (STEERING, {"action_repeat": 2}),
    (DOCKING, {}),
    (SANDY, {}),
    (SANDY, {"observation": "estimate"}),
]


same = np.testing.assert_equal  # bitwise


@pytest.mark.slow
@pytest.mark.parametrize("copied", COPIES, ids=["deepcopy", "pickle"])
@pytest.mark.parametrize(("name", "options"), KINDS)
def test_a_copy_continues_the_episode_bitwise(name: str, options: dict[str, Any], copied: Any) -> None:
    """One and many: what the original does after the copy, the copy does too, also in the next episode."""
    endings = {"endings": {"off path": off_path}} if name == STEERING else {}
    for env in (single(name, **options), many_of(name, 3, **options, **endings)):
        steps = 160 if endings and env.action_space.shape != (2,) else 25
        actions = (
            np.random.default_rng(1).uniform(-0.3, 0.5, (steps, *(env.action_space.shape or ()))).astype(np.float32)
        )
        env.reset(seed=3)
        for action in actions[:6]:
            env.step(action)
        twin = copied(env)
        for action in actions[6:]:
            same(twin.step(action), env.step(action))
        same((twin.reset(), twin.step(actions[0])), (env.reset(), env.step(actions[0])))


@pytest.mark.parametrize("name", [STEERING, DOCKING, SANDY])
def test_a_step_needs_a_reset_and_nothing_works_after_close(name: str) -> None:
    """The same errors for one and for many, gymnasium's own; a mask of the first reset leaves others unreset."""
    for env in (single(name, render_mode="rgb_array"), many_of(name, 2, render_mode="rgb_array")):
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


@pytest.mark.parametrize("name", [DOCKING, *(pytest.param(name, marks=pytest.mark.slow) for name in (STEERING, SANDY))])
def test_wrong_actions_are_refused_and_change_nothing(name: str) -> None:
    """A refused action leaves the episode as it was; of many, the number of the sub-environment is named."""
    env, untouched, many = single(name), single(name), many_of(name, 3)
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
    env, other = single(DOCKING), single(DOCKING)
    for one in (env, other):
        one.reset(seed=1)
    full = np.array([1.0, -1.0], dtype=np.float32)
    same_demand: list[Any] = [[1, -1], [1e300, -1e300], np.array([3.0, -2.0], np.float32), np.array([1, -1], np.int8)]
    for action in same_demand:
        same(other.step(action), env.step(full))


WRONG_OPTIONS: dict[str, list[tuple[Any, str]]] = {
    STEERING: [
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
    DOCKING: [
        ({"course": "roundabout"}, "unknown option 'course'"),
        ({1: 2}, "must be a dictionary of reset options by name"),
    ],
    SANDY: [
        ({"soil": ["beach_sand"]}, r"soil = \['beach_sand'\] must be one of"),
        ({"speed": {}}, "speed = {} must be a number or two bounds"),
    ],
}


@pytest.mark.parametrize("name", [STEERING, DOCKING, SANDY])
def test_wrong_reset_options_are_named(name: str) -> None:
    env = single(name)
    for options, says in WRONG_OPTIONS[name]:
        with pytest.raises(ValueError, match=says) as error:
            env.reset(options=options)
        assert "\n" not in str(error.value)
        assert len(str(error.value)) < 400
    env.reset(seed=1)


def test_wrong_seeds_are_named() -> None:
    env, many = single(DOCKING), many_of(DOCKING, 2)
    wrong: list[Any] = [-1, True, 1.5, NAN, "1", {}]
    for seed in wrong:
        for call in (lambda seed=seed: env.reset(seed=seed), lambda seed=seed: many.reset(seed=[1, seed])):
            with pytest.raises(ValueError, match=r"seed = .* must be a whole number >= 0"):
                call()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: many_of(DOCKING, 0), "num_envs = 0 must be a whole number"),
        (lambda: many_of(DOCKING, 10**9), "num_envs = 1000000000 must be .* at most 65536"),
        (
            lambda: many_of(DOCKING, autoreset_mode="Never"),
            "autoreset_mode = 'Never' must be one of NextStep, SameStep",
        ),
        (lambda: single(STEERING, action_repeat=1.5), "action_repeat = 1.5 must be a whole number"),
        (lambda: single(STEERING, action_repeat=10**9), "action_repeat = 1000000000 must be .* at most 1000"),
        (lambda: single("TrailerStearing-v0"), "unknown environment 'TrailerStearing-v0'; did you mean 'TrailerSteer"),
        (lambda: single(STEERING, vehicle="eu_tractor_semitrailer"), "steered axles"),
        (lambda: single(STEERING, courses=()), "courses is empty"),
        (lambda: single(STEERING, courses=("random-x",)), "random-K"),
        (lambda: single(STEERING, cours=()), "unknown key 'cours'; did you mean 'courses'"),
        (lambda: single(DOCKING, task="park"), "task = 'park'; known: bay, gate, road"),
        (lambda: single(SANDY, vehicle="el_dorado_ii"), "skid-steered"),
        (lambda: single(STEERING, courses="roundabout"), "courses = 'roundabout'"),
        (lambda: single(STEERING, courses=["motorway-exit"]), "course motorway-exit: its file has heights, banks"),
        (lambda: single(STEERING, domain=0.3), "domain = 0.3 must be"),
        (lambda: single(STEERING, domain={"frction": 0.3}), "unknown option 'frction'; did you mean 'friction'"),
        (lambda: single(DOCKING, domain={"friction": 3}), "friction = 3 .. 3 must be a range within 0.05 .. 1.5"),
        (lambda: single(STEERING, reward={"follow": 1.0}), "unknown part 'follow'; did you mean 'follow_error'"),
        (lambda: single(STEERING, reward={"follow_error": NAN}), "reward = .*: must be a finite number"),
        (lambda: single(SANDY, reward={"kerb": 1.0}), "unknown part 'kerb'; known: cross_track_error"),
        (lambda: single(STEERING, road_width=1.0), "road_width = 1 m must be at least 2.5 m"),
        (lambda: single(STEERING, courses=[{"kind": "roundabout", "radius": 1.0}]), "course.radius = 1.0 m must be"),
        (lambda: single(STEERING, courses=[{"kind": "roundabot"}]), "did you mean 'roundabout'"),
        (lambda: single(STEERING, reward={follow_error: NAN}), "reward = .*: must be a finite number"),
        (lambda: single(STEERING, observation="camera", image_scale=0), "image_scale = 0 must be 1 .. 48"),
        (lambda: single(STEERING, observation="camera", sensing="rover-slope"), "rover-slope is a rover's"),
        (lambda: single(SANDY, observation="camera", sensing="roundabout"), "roundabout is a trailer's"),
        (lambda: single(SANDY, observation="estimate", soils=("none",)), "firm ground takes no trace"),
        *(
            (lambda key=key: single(STEERING, observation="estimate", sensing=load_scenario("roundabout", [key])), line)
            for key, line in (
                ("off_tracking=truth", "use observation = 'truth'"),
                ("off_tracking=surrogate", "use observation = 'surrogate'"),
                ("rig.rate_hz=8", "multiple of the control step, 0.02 s"),
            )
        ),
        (lambda: single(SANDY, engine="steam"), "engine = 'steam'; known: auto, compiled, interpreted"),
        (lambda: single(SANDY, observation=2), "observation = 2 must be estimate, surrogate, truth, camera"),
        (lambda: Domain(friction=0.3), "friction = .* must be a number or two bounds"),  # type: ignore[arg-type]
        (lambda: Domain(speed=(NAN, 3.0)), "speed = nan .. 3 must be a range"),
    ],
)
def test_wrong_constructor_arguments_are_named(make: Callable[[], Any], says: str) -> None:
    with pytest.raises(ValueError, match=says) as error:
        make()
    assert "\n" not in str(error.value)
