"""The adapter for stable-baselines3; without the extra there is nothing to adapt to."""

import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import offtrack.environments.registry
from tests.environments import features, off_path

pytest.importorskip("stable_baselines3", reason="the extra rl is not installed: pip install 'offtrack[rl]'")

from stable_baselines3 import A2C, PPO, SAC, TD3
from stable_baselines3.common.env_checker import check_env

from controllers.trailer_steering.policy import TrainedFor
from offtrack.environments.sb3 import Sb3VecEnv, sb3_vector
from offtrack.environments.training.learner import saved_network

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", offtrack.environments.registry.CORES)
def test_its_own_checker_has_nothing_to_complain_of(name: str) -> None:
    check_env(gymnasium.make(f"offtrack/{name}", disable_env_checker=True).unwrapped)


def test_it_tells_what_the_vector_environment_does() -> None:
    """Same seed and actions: observations, rewards and ends are equal; infos report the ended episodes."""
    options: dict[str, Any] = {"endings": {"off path": off_path}}
    adapted = sb3_vector("TrailerSteering-v0", 3, reward_scale=0.5, **options)
    plain = offtrack.environments.registry.vector("TrailerSteering-v0", 3, autoreset_mode="SameStep", **options)
    adapted.seed(7)
    assert np.array_equal(features(adapted.reset()), features(plain.reset(seed=7)[0]))
    assert "true_rms_m" in adapted.reset_infos[2]
    rng, ended, total, steps = np.random.default_rng(1), 0, np.zeros(3), np.zeros(3)
    for _ in range(250):
        actions = rng.uniform(-1.0, 1.0, (3, 2)).astype(np.float32)
        seen, reward, done, infos = adapted.step(actions)
        expected, rewards, terminated, truncated, info = plain.step(actions)
        assert np.array_equal(features(seen), features(expected))
        assert reward == pytest.approx(0.5 * rewards, rel=1e-6)
        assert np.array_equal(done, terminated | truncated)
        total, steps = total + rewards, steps + 1
        for k in range(3):
            if not done[k]:
                assert infos[k] == {}
                continue
            ended += 1
            assert np.array_equal(infos[k]["terminal_observation"], info["final_obs"][k])
            assert infos[k]["TimeLimit.truncated"] == truncated[k]
            assert infos[k]["outcome"] == "off path"
            assert infos[k]["true_max_m"] == info["final_info"]["true_max_m"][k]
            assert infos[k]["episode"]["r"] == pytest.approx(total[k])
            assert infos[k]["episode"]["l"] == steps[k]
        total[done], steps[done] = 0.0, 0
    assert ended > 5


def test_it_is_one_object() -> None:
    """Attributes and methods belong to all sub-environments together; options may differ, for one reset."""
    env = sb3_vector("TrailerSteering-v0", 2, render_mode="rgb_array")
    env.set_options([{"length": 0.9}, {"length": 1.0}])
    env.seed(1)
    assert features(env.reset())[:, -1] == pytest.approx([12.6, 14.0])
    assert features(env.reset())[:, -1] != pytest.approx([12.6, 14.0])
    assert env.get_attr("num_envs") == [2, 2]
    assert env.env_method("render")[0][0].shape == (600, 600, 3)
    assert env.env_is_wrapped(gymnasium.Wrapper, indices=0) == [False]
    assert len(env.get_images()) == 2
    with pytest.raises(ValueError, match="one object"):
        env.set_attr("num_envs", 1, indices=[0])
    with pytest.raises(ValueError, match="reward_scale = nan must be a finite number"):
        sb3_vector("TrailerSteering-v0", 2, reward_scale=np.nan)
    with pytest.raises(ValueError, match="SAME_STEP"):
        Sb3VecEnv(offtrack.environments.registry.vector("TrailerSteering-v0", 2))


@pytest.mark.parametrize("make", [PPO, A2C, SAC, TD3])
def test_a_saved_model_becomes_a_law(make: Any, tmp_path: Path) -> None:
    """Its network gives the model's own mean actions; what does not fit is refused in one line."""
    env = sb3_vector("TrailerSteering-v0", 2, action_repeat=4)
    few = {"learning_starts": 4, "buffer_size": 100} if make in (SAC, TD3) else {"n_steps": 8}
    if make is PPO:
        few["batch_size"] = 16
    model = make("MlpPolicy", env, policy_kwargs={"net_arch": [16, 8]}, **few)
    model.learn(16)
    model.save(tmp_path / "model")
    seen = features(env.reset())
    network = saved_network(tmp_path / "model.zip", named(env), 2, TrainedFor())
    assert network(seen.astype(np.float64)) == pytest.approx(model.predict(seen, deterministic=True)[0], abs=1e-5)
    with pytest.raises(ValueError, match="has 18 inputs, the environment gives 20"):
        saved_network(tmp_path / "model.zip", (*named(env), "more", "yet_more"), 2, TrainedFor())
    with pytest.raises(ValueError, match="has 2 actions, the environment 3"):
        saved_network(tmp_path / "model.zip", named(env), 3, TrainedFor())


def named(env: Sb3VecEnv) -> tuple[str, ...]:
    return tuple(feature.name for feature in env.env.core.features)  # type: ignore[attr-defined]


def test_other_files_are_no_models(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("data", "{}")
    with zipfile.ZipFile(tmp_path / "damaged.zip", "w") as archive:
        archive.writestr("data", "{}")
        archive.writestr("policy.pth", b"no archive")
    for name, words in (("other", "it holds no 'policy.pth'"), ("damaged", "cannot be read")):
        with pytest.raises(ValueError, match=words):
            saved_network(tmp_path / f"{name}.zip", ("speed",), 2, TrainedFor())
