"""The rover's environment: its path, its slope, and what is seen of its slip."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest

import offtrack  # noqa: F401  # registers the environments
from offtrack.environments import rover_options
from offtrack.environments.rover_options import RoverMoment
from vehicle.frames import FloatArray

LEVEL = {"cross_fall": 0.0, "grade": 0.0, "curvature": 0.0, "speed": 0.1, "sensor_error": 1.0}
AHEAD = np.array([0.5, 0.5], dtype=np.float32)  # half of twice the set speed


def driven(steps: int, action: Any = AHEAD, **options: Any) -> tuple[Any, list[Any], dict[str, Any]]:
    """The environment, its observations and the last info after ``steps`` of the same action."""
    env = gymnasium.make("offtrack/RoverSteering-v0", observation=options.pop("observation", "truth"))
    seen, _ = env.reset(seed=1, options={**LEVEL, **options})
    told = [seen]
    for _ in range(steps):
        seen, _, terminated, truncated, info = env.step(action)
        told.append(seen)
        if terminated or truncated:
            break
    return env, told, info


def test_straight_ahead_on_level_ground_completes_the_path() -> None:
    """Equal sides keep the straight path to a millimetre, at the set speed less some slip."""
    _, told, info = driven(1000, soil="none")
    assert info["outcome"] == "completed"
    assert info["cross_track_max_m"] < 1e-3
    assert len(told) == pytest.approx(7.0 / 0.1 / 0.1, rel=0.05)  # steps of 0.1 s; firm ground slips little


def test_the_reward_is_the_sum_of_its_parts_and_can_be_ones_own() -> None:
    """The usual one as documented, and one function of the rover's moment alone."""

    def rewarded(**options: Any) -> tuple[float, dict[str, Any]]:
        env = gymnasium.make("offtrack/RoverSteering-v0", observation="truth", **options)
        env.reset(seed=1, options={**LEVEL, "soil": "none", "cross_fall": 0.1})
        for _ in range(20):
            _, reward, _, _, info = env.step(np.array([0.4, 0.5], dtype=np.float32))
        return float(reward), info

    def left_of_path(moment: RoverMoment) -> FloatArray:
        assert moment.demand_right[0] - moment.demand_left[0] == pytest.approx(0.1, abs=1e-6)
        return moment.cross_track

    usual, info = rewarded()
    slowness, _ = rewarded(reward={rover_options.slowness: 1.0})
    own, _ = rewarded(reward={left_of_path: 2.0})
    assert own == pytest.approx(2.0 * info["cross_track"], rel=1e-6)
    assert usual == pytest.approx(-((info["cross_track"] / 0.1) ** 2) + 0.1 * slowness - 0.01 * 0.1**2, rel=1e-5)
    assert -0.2 < slowness < 0.0


def test_a_side_slope_of_sand_pulls_the_rover_down() -> None:
    """Ground that rises to the left lets it drift to the right, and its slip angle shows it; mirrored, to the left."""
    for side in (1.0, -1.0):
        _, told, info = driven(100, soil="toyoura_sand", cross_fall=side * 0.09)
        assert side * info["cross_track"] < -0.01
        assert side * info["slip_angle"] < -math.radians(0.5)
        assert told[-1][4] == pytest.approx(info["slip_angle"], abs=1e-6)  # rounding of 32 bits
        assert told[-1][9] == pytest.approx(side * 0.09, abs=0.02)  # the inclination to the left


def test_the_surrogates_slip_angle_scatters_as_one_seen_in_a_trace() -> None:
    """1.4 deg RMS about the true one; 200 samples know it to 10 %."""
    _, exact, _ = driven(200, soil="none")
    _, seen, _ = driven(200, soil="none", observation="surrogate")
    error = np.array(seen)[1:, 4] - np.array(exact)[1:, 4]
    assert np.std(error) == pytest.approx(math.radians(1.4), rel=0.15)


def test_a_difference_of_the_sides_turns_it_and_leaves_the_path() -> None:
    """The right side faster turns to the left; a metre beside the path ends the episode."""
    _, told, info = driven(400, np.array([0.2, 0.8], dtype=np.float32), soil="none")
    assert told[20][5] > 0.05
    assert info["outcome"] == "left the path"
    assert info["cross_track"] > 1.0
