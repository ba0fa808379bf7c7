"""Action repeat: actions that hold for several control steps."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import offtrack.environments.registry
from offtrack.environments.core import Observation
from offtrack.environments.registry import CoreVectorEnv
from offtrack.environments.rewards import Moment

TRAILER = "offtrack/TrailerSteering-v0"


def vector(n: int, **options: Any) -> CoreVectorEnv:
    """Environments without autoreset."""
    return offtrack.environments.registry.vector("TrailerSteering-v0", n, autoreset_mode="Disabled", **options)


def equal(one: Observation, other: Observation) -> bool:
    """True if two observations without images are bitwise equal."""
    assert isinstance(one, np.ndarray)
    assert isinstance(other, np.ndarray)
    return np.array_equal(one, other)


def late(moment: Moment) -> Any:
    """Ending that steering to the left meets soon."""
    return np.abs(moment.off_tracking) > 0.022


def test_an_action_that_holds_is_the_same_action_again_and_again() -> None:
    """Three steps at once against three in a row: observation, added rewards and metrics, bitwise."""
    held, single = vector(2, action_repeat=3), vector(2)
    assert held.metadata["render_fps"] == round(50 / 3)
    assert equal(held.reset(seed=3)[0], single.reset(seed=3)[0])
    rng = np.random.default_rng(1)
    for _ in range(20):
        action = rng.uniform(-1.0, 1.0, (2, 2)).astype(np.float32)
        seen, reward, *_, info = held.step(action)
        three = [single.step(action) for _ in range(3)]
        assert equal(seen, three[-1][0])
        assert np.array_equal(reward, three[0][1] + three[1][1] + three[2][1])
        assert np.array_equal(info["true_rms_m"], three[-1][4]["true_rms_m"])


def test_an_end_within_a_decision_is_kept_and_costs_once() -> None:
    """In any of the steps: the outcome is reported, and no reward is added after the end."""
    options: dict[str, Any] = {"endings": {"late": late}, "observation": "truth"}
    held, single = vector(1, action_repeat=5, **options), vector(1, **options)
    given = {"course": "roundabout", "friction": 0.8, "speed": 3.0}
    for env in (held, single):
        env.reset(seed=1, options=given)
    action = np.ones((1, 2), dtype=np.float32)
    total, steps, ended = 0.0, 0, False
    while not ended:
        _, reward, terminated, _, _ = single.step(action)
        total, steps, ended = total + float(reward[0]), steps + 1, bool(terminated[0])
    assert steps % 5  # in the middle of a decision
    together = 0.0
    for _ in range(steps // 5 + 1):
        _, reward, terminated, truncated, info = held.step(action)
        together += float(reward[0])
    assert terminated[0]
    assert not truncated[0]
    assert info["outcome"][0] == "late"
    assert together == pytest.approx(total, rel=1e-12)


def test_it_is_an_option_of_every_environment() -> None:
    """Single environments have it too; less than one step is refused in one line."""
    env = gymnasium.make(TRAILER, action_repeat=2, disable_env_checker=True)
    env.reset(seed=1)
    assert env.metadata["render_fps"] == 25
    with pytest.raises(ValueError, match="action_repeat = 0 must be a whole number, at least 1"):
        gymnasium.make("offtrack/RoverSteering-v0", action_repeat=0)
