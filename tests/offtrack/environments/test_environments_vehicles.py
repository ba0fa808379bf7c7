"""Environments of single kinds: driving into a bay, the rover on its slope, and actions that hold for several steps."""

import math
from typing import Any

import gymnasium
import numpy as np
import pytest

import offtrack  # noqa: F401  # registers the environments
from offtrack.environments import rover_options
from offtrack.environments.registry import single, vector
from offtrack.environments.rover_options import RoverMoment
from tests.environments import features
from vehicle.frames import FloatArray

DRIVING = "offtrack/TractorTrailerDriving-v0"


def test_backing_into_a_bay_completes_once_the_trailer_stands_there() -> None:
    """Straight back by 10 m at up to 1 m/s: within 0.3 m it stops, which ends the episode; before, it is too fast."""
    env = gymnasium.make(DRIVING, task="bay", disable_env_checker=True)
    env.reset(seed=1, options={"cross_fall": 0.0, "length": 1.0})
    core = env.unwrapped.core  # type: ignore[attr-defined]
    x, y, psi = core.now.poses[0, -1]
    core.aim.poses[0] = x + core.vehicle.units[-1].rear_x - 10.0, y, psi
    terminated, speed = False, 0.0
    while not terminated:
        ahead = core.aim.relative[0, 0]
        pace = -min(1.0, math.sqrt(max(0.6 * (-ahead - 0.15), 0.0)))
        seen, reward, terminated, truncated, info = env.step(
            np.array([0.0, 2.0 * (pace - speed)], np.float32).clip(-1, 1)
        )
        speed = float(seen[5])
        assert not truncated
    assert (info["outcome"], float(reward) > 90.0) == ("completed", True)
    assert info["distance_m"] < 0.3


LEVEL_ROAD = {"cross_fall": 0.0, "load": 1.0, "length": 1.0}


def speeds(friction: float, *demands: tuple[float, float]) -> list[FloatArray]:
    """Speeds of the tractor every 20 ms [m/s], for demands of acceleration [m/s2] that each last some seconds."""
    env = single("TractorTrailerDriving-v0", task="bay")
    env.reset(seed=1, options={**LEVEL_ROAD, "friction": friction})
    return [
        np.array([env.step(np.array([0.0, demand], np.float32))[0][5] for _ in range(round(50 * seconds))])
        for demand, seconds in demands
    ]


def test_the_gear_follows_the_demand_once_the_brakes_have_stopped_the_combination() -> None:
    """1 m/s2 back for 2 s, forward for 4 s: it slows, stops and goes on the other way at the same rate, no jump."""
    back, forward = speeds(0.8, (-1.0, 2.0), (1.0, 4.0))
    # 0.25 s of lag and 0.006 g of rolling drag at first; wheels and gearing take 1 to 2 %.
    assert back[-1] == pytest.approx(-(2.0 - 0.25) * (1.0 - 0.06), abs=0.05)
    braking, driving = (forward[80] - forward[55]) / 0.5, (forward[-1] - forward[-26]) / 0.5
    assert braking == pytest.approx(1.06 / 1.013, rel=0.02)  # drag helps the brakes ...
    assert driving == pytest.approx(0.94 / 1.013, rel=0.02)  # ... and holds the engine back
    assert np.abs(np.diff(np.concatenate([back, forward]))).max() < 0.03  # 1.5 m/s2: it rocks on its tyres as it stops


def test_driven_wheels_slip_backwards_too() -> None:
    """On ice of friction 0.05 an axle that carries 11.4 of 40 t pushes with 0.14 m/s2 at most, at any demand."""
    on_asphalt, on_ice = (float(speeds(friction, (-1.0, 2.0))[0][-1]) for friction in (0.8, 0.05))
    assert -2.0 * 0.05 * 9.81 * 12.0 / 40.0 < on_ice < -0.02
    assert on_asphalt < -1.5


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


@pytest.mark.slow
def test_an_action_that_holds_is_the_same_action_again_and_again() -> None:
    """Three steps at once against three in a row: observation, added rewards and metrics, bitwise."""
    held, single = (vector("TrailerSteering-v0", 2, autoreset_mode="Disabled", action_repeat=k) for k in (3, 1))
    assert held.metadata["render_fps"] == round(50 / 3)
    assert np.array_equal(features(held.reset(seed=3)[0]), features(single.reset(seed=3)[0]))
    rng = np.random.default_rng(1)
    for _ in range(20):
        action = rng.uniform(-1.0, 1.0, (2, 2)).astype(np.float32)
        seen, reward, *_, info = held.step(action)
        three = [single.step(action) for _ in range(3)]
        assert np.array_equal(features(seen), features(three[-1][0]))
        assert np.array_equal(reward, three[0][1] + three[1][1] + three[2][1])
        assert np.array_equal(info["true_rms_m"], three[-1][4]["true_rms_m"])


def test_an_end_within_a_decision_is_kept_and_costs_once() -> None:
    """In any of the steps: the outcome is reported, and no reward is added after the end."""
    options: dict[str, Any] = {"endings": {"late": lambda moment: np.abs(moment.off_tracking) > 0.022}}
    options |= {"observation": "truth", "autoreset_mode": "Disabled"}
    held, single = (vector("TrailerSteering-v0", 1, action_repeat=k, **options) for k in (5, 1))
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
