"""Tasks of the benchmark: roads with edges, environments by plain values, drivers by hand, results and their files."""

import json
import math
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from typer.testing import CliRunner

import offtrack
from offtrack.commands.cli import app
from offtrack.environments import rewards, rover_options
from offtrack.environments.drivers import Tracks
from offtrack.environments.registry import single
from offtrack.environments.rewards import Domain
from offtrack.environments.road_edges import RoadEdges
from offtrack.environments.tasks import FIRST_SEED, LAWS, TASKS, task_of
from offtrack.environments.trailer_steering import named_course
from offtrack.environments.training import benchmark
from offtrack.environments.training.benchmark import (
    Episode,
    Evaluation,
    Results,
    evaluated,
    header,
    mean,
    networks,
    read_results,
    share,
    shipped_results,
    summary,
    write_results,
)
from offtrack.environments.training.pilots import DRIVERS
from scenarios.catalogue import TRAILER_STEERING
from scenarios.progress import no_progress
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray

VEHICLE = load_vehicle("uk_longer_semitrailer")
HALF = 0.5 * VEHICLE.units[-1].width


def clearances(course: Any, width: float, *poses: FloatArray) -> FloatArray:
    """Left and right clearance of one vehicle after poses (N, 3) one after another."""
    edges = RoadEdges(VEHICLE, Tracks([named_course(course, VEHICLE)]), width, 1)
    edges.begin(np.arange(1), np.zeros(1, dtype=np.intp), np.zeros(1))
    for pose in poses:
        edges.step(np.zeros(1, dtype=np.intp), pose[None])
    sides: FloatArray = edges.sides[0]
    return sides


def straight(y: float, psi: float) -> FloatArray:
    """Poses of a straight combination at y [m] and heading [rad]; the hitch is where its file has it."""
    ahead = VEHICLE.units[0].rear_hitch[0]
    return np.array([[0.0, y, psi], [ahead * math.cos(psi), y + ahead * math.sin(psi), psi]])


def test_on_a_straight_road_the_clearance_is_that_of_the_corners() -> None:
    """Half the road less half the width, less the lateral place of the farthest corner of a turned combination."""
    road = {"kind": "straight", "length": 50.0}
    assert clearances(road, 8.0) == pytest.approx([4.0 - HALF] * 2, abs=1e-9)
    assert clearances(road, 8.0, straight(0.7, 0.0)) == pytest.approx([3.3 - HALF, 4.7 - HALF], abs=1e-9)
    front, rear = VEHICLE.units[0].front_x, VEHICLE.units[0].rear_hitch[0] + VEHICLE.units[1].rear_x
    psi = 0.05
    left = front * math.sin(psi) + 0.5 * VEHICLE.units[0].width * math.cos(psi)
    right = rear * math.sin(psi) - HALF * math.cos(psi)
    assert clearances(road, 8.0, straight(0.0, psi)) == pytest.approx([4.0 - left, 4.0 + right], abs=1e-6)


@pytest.mark.parametrize(("direction", "side"), [("left", 1.0), ("right", -1.0)])
def test_on_a_circle_the_clearance_is_that_of_the_radii(direction: str, side: float) -> None:
    """All points on known radii about the circle's centre: the outer edge is 0.5 m beyond the guided front corner."""
    radius, width, tractor = 15.0, 7.0, VEHICLE.units[0]
    road = {"kind": "roundabout", "direction": direction, "radius": radius, "turn_deg": 300.0, "entry": 20.0}
    course = named_course(road, VEHICLE)
    centre = complex(*course.surface_centre or ())
    lateral = math.sqrt(radius**2 - tractor.front_x**2) - 0.5 * tractor.width  # of the rear axle's middle
    hitch = math.hypot(lateral, tractor.rear_hitch[0])
    front, rear = VEHICLE.units[1].front_x, VEHICLE.units[1].rear_x
    to_axle = -np.linspace(front, rear, math.ceil((front - rear) / 3.0) + 1)[
        -3
    ]  # it turns about a watched point's side
    path: list[FloatArray] = []
    for turned in np.linspace(0.0, 3.0, 400):  # so finely that every point is found again from the one before
        x, psi = centre + lateral * np.exp(1j * side * (turned - 0.5 * np.pi)), side * turned
        at = centre + hitch * np.exp(1j * side * (turned - 0.5 * np.pi + math.atan2(tractor.rear_hitch[0], lateral)))
        heading = np.angle(1j * side * (at - centre)) - side * math.asin(to_axle / hitch)
        path.append(np.array([[x.real, x.imag, psi], [at.real, at.imag, heading]]))
    left, right = clearances(road, width, *path)
    outer, inner = (right, left) if side > 0.0 else (left, right)
    assert outer == pytest.approx(0.5, abs=2e-3)  # tables of 0.1 m
    inside = math.sqrt(hitch**2 - to_axle**2) - HALF  # of that point, the nearest to the centre
    assert inner == pytest.approx(inside - (radius - (width - 0.5)), abs=2e-3)


def test_plain_values_are_what_functions_and_classes_are() -> None:
    """Reward, domain and course by names and numbers: the same episode, bit by bit."""
    table = {"kind": "turn", "radius": 12.5, "turn_deg": 90.0, "direction": "left"}
    plain: dict[str, Any] = {
        "reward": {"kerb": 2.0, "follow_error": 1.0},
        "domain": {"friction": (0.3, 0.4)},
        "courses": [table],
    }
    own: dict[str, Any] = {
        "reward": {rewards.kerb: 2.0, rewards.follow_error: 1.0},
        "domain": Domain(friction=(0.3, 0.4)),
        "courses": [named_course(table, VEHICLE)],
    }
    told = []
    for options in (plain, own):
        env = single("TrailerSteering-v0", **options)
        env.reset(seed=3)
        told.append([env.step(np.full(2, 0.3, dtype=np.float32))[1] for _ in range(40)])
    assert told[0] == told[1]
    assert gymnasium.make("offtrack/RoverSteering-v0", reward={"slowness": 1.0}, disable_env_checker=True)
    for parts in (rewards.PARTS, rover_options.PARTS):
        assert len({part.__name__ for part in parts}) == len(parts)
    assert offtrack.__name__


@pytest.mark.parametrize("name", list(TASKS))
def test_a_task_keeps_its_evaluation_apart_from_its_training(name: str) -> None:
    """No course of the evaluation is trained on; baselines exist; each episode is short enough to be run."""
    task = TASKS[name]
    seen, unseen = (task.environment_options(training=training).get("courses", []) for training in (True, False))
    assert not [course for course in unseen if course in seen]
    assert set(task.drivers) <= set(TRAILER_STEERING) | set(DRIVERS)
    assert (task.role == "trailer") == (task.drivers == LAWS)
    assert header(Evaluation(name, task.drivers[0]))["task"] == name


def test_intervals_are_those_of_the_textbook() -> None:
    """Clopper and Pearson's interval for 8 of 10 is 0.444 to 0.975, for none of 100 0 to 3.6 %; of a constant none."""
    assert share(8, 10) == pytest.approx((0.8, 0.4439, 0.9748), abs=1e-4)
    assert share(0, 100) == pytest.approx((0.0, 0.0, 0.0362), abs=1e-4)
    assert mean([0.25] * 7) == (0.25, 0.25, 0.25)
    spread = mean(np.random.default_rng(3).normal(size=400).tolist())
    assert spread.high - spread.low == pytest.approx(2.0 * 1.96 / 20.0, rel=0.15)  # of a normal mean


def test_an_interrupted_evaluation_goes_on_as_if_it_had_not_been(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Block by block the file grows; its rows are those of one evaluation without interrupt, to the last digit."""
    monkeypatch.setattr(benchmark, "BLOCK", 2)
    kept: list[Results] = []
    asked = Evaluation("gate", "through_gate")
    head = header(asked)
    whole = evaluated(asked, head, 4, no_progress, keep=kept.append)
    assert [len(one.episodes) for one in kept] == [2, 4]
    write_results(kept[0], tmp_path / "part.json")
    rest = evaluated(asked, head, 4, no_progress, former=read_results(tmp_path / "part.json"))
    assert rest.episodes == whole.episodes
    assert all(episode.success and episode.error_m < 0.3 for episode in whole.episodes)


def test_results_that_were_changed_are_refused(tmp_path: Path) -> None:
    head = {**header(Evaluation("bay", "into_bay")), "processor_s": 1.0}
    results = Results(head, (Episode("timed out", False, 1.5, None, 0.1), Episode("completed", True, 0.2, None, 0.2)))
    file = tmp_path / "results.json"
    write_results(results, file)
    assert read_results(file) == results
    assert summary(results)["success"].mean == 0.5
    text = file.read_text(encoding="utf-8")
    for old, new, words in (
        ('"timed out", false', '"completed", true', "was changed after the evaluation"),
        ('"task": "bay"', '"task": "boy"', "not a results file"),
        ('"version": 1', '"version": 2', "not a results file"),
        ("{", "[", "not a results file"),
    ):
        file.write_text(text.replace(old, new, 1), encoding="utf-8")
        with pytest.raises(ValueError, match=words):
            read_results(file)


def test_the_command_lists_evaluates_and_refuses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke
    listed = json.loads(run(app, ["benchmark", "--json"]).stdout)
    assert list(listed) == list(TASKS)
    first = run(app, ["benchmark", "rover-slope", "--policy", "on_slope", "--episodes", "1", "--json"])
    assert first.exit_code == 0, first.stderr
    assert any(row["policy"] == "on_slope" and row["episodes"] == 1 for row in json.loads(first.stdout))
    file = tmp_path / "runs" / "benchmark-rover-slope-on_slope.json"
    again = run(app, ["benchmark", "rover-slope", "--policy", str(file), "--json"])
    assert json.loads(again.stdout) == json.loads(first.stdout)
    own = read_results(file)
    write_results(own._replace(head={**own.head, "vehicle": "mine"}), tmp_path / "mine.json")
    for arguments, words in (
        (["rover-slope", "--policy", "mine.json"], "holds results of another vehicle, mine"),
        (["gates"], "unknown task 'gates'; did you mean 'gate'"),
        (["--policy", "on_road"], "--policy needs a task"),
        (["gate", "--policy", "on_road"], "must be one of through_gate"),
        (["roundabouts", "--policy", "on_road"], "must be one of none, command_steer"),
        (["gate", "--policy", "through_gate", "--observation", "truth"], "of task gate has no choice"),
        (["roundabouts", "--policy", "none", "--observation", "camera"], "must be surrogate, truth or estimate"),
        (["gate", "--policy", str(file)], "holds results of the task rover-slope"),
        (["gate", "--policy", "none.npz"], "none.npz"),
        (["gate", "--policy", "trailer_steering_v0"], "must be one of"),
        (["rover-slope", "--policy", "ignoring_slip", "--out", str(file)], "has results with another policy"),
        (["gate", "--episodes", "0"], "--episodes"),
        (["gate", "--out", "results.json"], "need a --policy"),
        (["gate", "--policy", "nothing.json"], "nothing.json"),
    ):
        result = run(app, ["benchmark", *arguments])
        assert result.exit_code == 2, arguments
        assert words in result.stderr
        assert result.stderr.count("\n") == 1


def test_shipped_results_are_those_of_this_program() -> None:
    """Every shipped file is whole; its seeds are the benchmark's; a network's are those of the shipped file."""
    for name in TASKS:
        for results in shipped_results(name):
            head = header(Evaluation(name, results.head["policy"], results.head["observation"]))
            assert results.head["first_seed"] == FIRST_SEED
            assert results.head["policy_sha256"] == head["policy_sha256"]
            assert len(results.episodes) >= 20


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, task in TASKS.items() if task.role != "trailer"])
def test_shipped_results_are_found_again(name: str) -> None:
    """The first episodes of drivers and networks; another processor may round differently."""
    for results in shipped_results(name):
        asked = Evaluation(name, results.head["policy"], results.head["observation"])
        found = evaluated(asked, header(asked), 3, no_progress)
        for episode, shipped in zip(found.episodes, results.episodes, strict=False):
            assert episode.success == shipped.success
            assert episode.error_m == pytest.approx(shipped.error_m, abs=0.02)


@pytest.mark.slow
def test_the_shipped_driver_masters_the_road() -> None:
    """Twelve episodes of the road task; the shipped results have a hundred."""
    asked = Evaluation("roundabouts-driver", "on_road")
    results = evaluated(asked, header(asked), 12, no_progress)
    assert all(episode.success for episode in results.episodes)
    assert min(episode.clearance_m or 0.0 for episode in results.episodes) > 0.0


def test_trainings_with_several_seeds_are_one_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interval of Student's t: 4.303 standard errors of three means."""
    names = [f"gate-ppo-{seed}" for seed in (1, 2, 3)]
    monkeypatch.setattr(benchmark, "networks", lambda: dict.fromkeys(names, Path()))
    rows = [
        summary(
            Results(
                {**header(Evaluation("gate", "through_gate")), "policy": name, "processor_s": 1.0},
                (Episode("completed", True, error, None, 0.1),) * 4,
            )
        )
        for name, error in zip([*names, "through_gate"], (1.1, 1.2, 1.3, 9.0), strict=True)
    ]
    [row] = benchmark.of_trainings(rows)
    assert (row["policy"], row["trainings"], row["clearance_m"]) == ("gate-ppo", 3, None)
    half = 4.303 * 0.1 / math.sqrt(3)
    assert row["error_m"] == pytest.approx((1.2, 1.2 - half, 1.2 + half), abs=1e-4)
    assert row["success"] == (1.0, 1.0, 1.0)


def test_networks_of_tasks_name_task_and_algorithm() -> None:
    for name, file in networks().items():
        task, algorithm, seed = name.rsplit("-", 2)
        assert task_of(task)
        assert (algorithm in ("ppo", "sac"), seed.isdecimal()) == (True, True)
        manifest = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
        assert manifest["plan"]["task"] == task


def test_on_a_road_the_reward_is_the_way_made_good() -> None:
    """Straight on, far from the edges: as many metres as the tractor drives, from the first step on."""
    road = {"kind": "straight", "length": 60.0}
    env = single("TractorTrailerDriving-v0", task="road", courses=[road], road_width=10.0, domain={"cross_fall": 0.0})
    _, info = env.reset(seed=1)
    left = info["distance_m"]
    assert left == pytest.approx(60.0)
    for _ in range(25):
        _, reward, _, _, info = env.step(np.zeros(2, dtype=np.float32))
        assert reward == pytest.approx(left - info["distance_m"], abs=1e-9)
        left = info["distance_m"]
    assert left == pytest.approx(60.0 - 25 * reward, rel=0.02)  # it rolls on at nearly the same speed


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--task", "gates"], "did you mean 'gate'"),
        (["--algorithm", "dqn"], "--algorithm dqn: must be ppo or sac"),
        (["--task", "gate", "--vehicle", "a_double"], "task gate has a vehicle of its own"),
    ],
)
def test_a_training_for_a_task_refuses_what_does_not_fit(arguments: list[str], words: str) -> None:
    pytest.importorskip("stable_baselines3")
    result = CliRunner().invoke(app, ["train", *arguments])
    assert result.exit_code == 2
    assert words in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "envs"), [("ppo", 8), ("sac", 2)])
def test_a_task_is_trained_and_goes_on(algorithm: str, envs: int, tmp_path: Path) -> None:
    """Some updates, then more by the same command; the network is evaluated on the benchmark's seeds."""
    pytest.importorskip("stable_baselines3")
    options = ["--task", "gate", "--algorithm", algorithm, "--envs", str(envs), "--threads", "1", "--json"]
    for steps in (25_000, 30_000):
        result = CliRunner().invoke(app, ["train", *options, "--steps", str(steps), "--out", str(tmp_path)])
        assert result.exit_code == 0, result.stderr
        told = json.loads(result.stdout)
        assert told["steps"] >= steps
        assert told["plan"]["algorithm"] == algorithm
    results = read_results(tmp_path / "benchmark.json")
    assert (results.head["task"], len(results.episodes)) == ("gate", 100)
    assert header(Evaluation("gate", str(tmp_path / "policy.npz")))["policy_sha256"] == results.head["policy_sha256"]
