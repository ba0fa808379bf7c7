"""Training: plan, curve, comparison with laws of the scenarios; with the extra, learning itself and resuming it."""

import base64
import importlib.util
import io
import json
import math
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from controllers.trailer_steering.policy import Network, TrainedFor, feature_names, load_network, save_network
from offtrack.commands.cli import app
from offtrack.environments.registry import vector
from offtrack.environments.training.benchmark import Evaluation, evaluated, header, read_results
from offtrack.environments.training.law_pilot import LawPilot
from offtrack.environments.training.training_directory import (
    Plan,
    Point,
    check_directory,
    draw_curve,
    opened_directory,
    read_curve,
    write_curve,
)
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.progress import no_progress
from scenarios.results.metrics import rms, true_off_tracking
from tests.environments import PERFECT, features
from vehicle.combination.description import load_vehicle

needs_extra = pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None,
    reason="the extra rl is not installed: pip install 'offtrack[rl]'",
)


def test_a_curve_is_read_as_it_was_written_and_drawn(tmp_path: Path) -> None:
    """Updates in which no episode ended have no off-tracking, and no place in the picture."""
    curve = [
        Point(steps, 1e-3 * steps, 3, rms_m, 2.0 * rms_m, 0.0, -0.1, 0.2, 0.01, 0.9, 0.5)
        for steps, rms_m in ((1000, math.nan), (2000, 0.5), (3000, 0.25))
    ]
    write_curve(curve, tmp_path / "curve.parquet")
    assert str(read_curve(tmp_path / "curve.parquet")) == str(curve)
    draw_curve(curve, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["curve.parquet", "curve.png"]


def test_a_directory_keeps_to_one_training(tmp_path: Path) -> None:
    """The same plan goes on; another one, or what is no training, is refused in one line."""
    check_directory(Plan(seed=1), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    with opened_directory(Plan(seed=1), tmp_path / "run"):
        check_directory(Plan(seed=1), tmp_path / "run")
    with pytest.raises(ValueError, match="with other options"):
        check_directory(Plan(seed=2), tmp_path / "run")
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(ValueError, match="is not empty"):
        check_directory(Plan(), tmp_path)


@pytest.mark.slow
def test_a_network_is_evaluated_as_the_law_that_it_becomes(tmp_path: Path) -> None:
    """A network of zeros is what `none` is within its domain; for no speed at all it is what path preview is."""
    names = feature_names(2, [unit.name for unit in load_vehicle("uk_longer_semitrailer").units])
    ones = np.ones(len(names))
    zeros = Network((np.zeros((2, len(names))),), (np.zeros(2),), 0.0 * ones, ones, names)
    found = {}
    for name, fastest in (("zeros", 10.0), ("nowhere", -10.0)):
        save_network(zeros._replace(trained_for=TrainedFor(speed=(fastest - 1.0, fastest))), tmp_path / f"{name}.npz")
    for policy in ("none", "path_preview", str(tmp_path / "zeros.npz"), str(tmp_path / "nowhere.npz")):
        asked = Evaluation("slippery-turn", policy)
        found[Path(policy).stem] = evaluated(asked, header(asked), 2, no_progress).episodes
    assert found["zeros"] == found["none"]
    assert found["nowhere"] == found["path_preview"] != found["none"]


def test_without_the_extra_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    missing = ("stable_baselines3", "torch")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in missing else found(name))
    result = CliRunner().invoke(app, ["train"])
    assert result.exit_code == 2
    assert "pip install 'offtrack[rl]'" in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.slow
@needs_extra
def test_a_training_is_gone_on_with_and_its_network_is_the_learners(tmp_path: Path) -> None:
    """Two updates, then two more by the same command; the arrays give the mean action of the checkpoint's model."""
    from stable_baselines3 import PPO

    def told(steps: int, out: str) -> dict[str, object]:
        options = ["--task", "slippery-turn", "--envs", "8", "--episodes", "1", "--threads", "1", "--seed", "101"]
        options += ["--json"]
        result = CliRunner().invoke(app, ["train", "--steps", str(steps), "--out", str(tmp_path / out), *options])
        assert result.exit_code == 0, result.stderr
        answer: dict[str, object] = json.loads(result.stdout)
        return answer

    assert told(2048, "run")["steps"] == 2048
    first = read_curve(tmp_path / "run" / "learning_curve.parquet")
    told(2048, "again")
    of_both = [load_network(tmp_path / name / "policy.npz") for name in ("run", "again")]
    assert all(np.array_equal(a, b) for a, b in zip(of_both[0].weights, of_both[1].weights, strict=True))
    assert told(4096, "run")["steps"] == 4096
    curve = read_curve(tmp_path / "run" / "learning_curve.parquet")
    assert [p.steps for p in curve] == [1024, 2048, 3072, 4096]
    assert str(curve[:2]) == str(first)
    network, model = load_network(tmp_path / "run" / "policy.npz"), PPO.load(tmp_path / "run" / "checkpoint.zip")
    features = np.random.default_rng(1).normal(size=(50, 18)).astype(np.float32)
    expected, _ = model.predict(features, deterministic=True)
    assert network(features.astype(np.float64)) == pytest.approx(expected, abs=1e-5)
    assert not any(file.name.startswith(".") for file in (tmp_path / "run").iterdir())
    kept = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert {"policy", "none"} <= {row["policy"] for row in kept["benchmark"]}
    assert len(read_results(tmp_path / "run" / "benchmark.json").episodes) == 1


class _Planted:
    def __reduce__(self) -> tuple[Any, tuple[Path]]:
        return Path.touch, (Path("was here"),)


@pytest.mark.slow
@needs_extra
@pytest.mark.parametrize("place", ["policy_class", "observation_space", "policy.pth"])
def test_objects_in_a_checkpoint_are_not_unpickled(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    from offtrack.environments.training.learner import Budget, learn

    monkeypatch.chdir(tmp_path)
    plan, directory = Plan(envs=8), tmp_path / "run"
    directory.mkdir()
    learn(plan, Budget(1024, None), directory, no_progress)
    with zipfile.ZipFile(directory / "checkpoint.zip") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    if place in members:
        stream = io.BytesIO()
        torch.save({"planted": _Planted()}, stream)
        members[place] = stream.getvalue()
    else:
        description = json.loads(members["data"])
        description[place] = {":serialized:": base64.b64encode(pickle.dumps(_Planted())).decode()}
        members["data"] = json.dumps(description).encode()
    with zipfile.ZipFile(directory / "checkpoint.zip", "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    if place in members:
        with pytest.raises(ValueError, match=r"^[^\n]*checkpoint\.zip: training can not be resumed[^\n]*$"):
            learn(plan, Budget(2048, None), directory, no_progress)
    else:
        assert len(learn(plan, Budget(2048, None), directory, no_progress)[1]) == 2
    assert not (tmp_path / "was here").exists()


NOMINAL = {"friction": 0.8, "cross_fall": 0.0, "speed": 10.0 / 3.6, "load": 1.0, "length": 1.0, "actuator_lag": 1.0}


@pytest.mark.slow
@pytest.mark.parametrize("law", ["path_preview", "command_steer"])
def test_a_law_steers_as_in_a_scenario(law: str) -> None:
    """A third of the roundabout with an estimate that is exact and a frame late: off-tracking within 1 cm RMS.

    The scenario's path is points a frame apart and its velocities are means over a frame; here they are of now.
    """
    settings = [f"trailer_steering={law}", "off_tracking=truth", "course.turn_deg=120", "signals.noise=0"]
    settings += ["course.entry=20", "course.exit=10"]
    parts = assemble(load_scenario("roundabout", settings), 1)
    session = TrailerSession(parts)
    while session.outcome is None:
        session.advance()
    session.close()
    x, y, psi = np.array([row.truth.poses[1] for row in session.rows]).T
    in_scenario = true_off_tracking(x, y, psi, 14.0)
    env = vector("TrailerSteering-v0", 1, courses=(parts.course,), surrogate=PERFECT, autoreset_mode="Disabled")
    pilot = LawPilot(env.core, load_vehicle("uk_longer_semitrailer"), law, PERFECT)  # type: ignore[arg-type]
    seen, _ = env.reset(seed=1, options={**NOMINAL, "sensor_error": 0.0})
    pilot.begin(features(seen))
    told, ended = [], False
    while not ended:
        seen, _, terminated, truncated, info = env.step(pilot.act(features(seen), np.ones(1, dtype=bool)))
        told.append(info["off_tracking"][0])
        ended = bool(terminated[0] | truncated[0])
    there = in_scenario[2::2][: len(told)]
    both = np.isfinite(there)
    assert rms(there) > (0.003 if law == "path_preview" else 0.3)
    assert rms(np.array(told)[: len(there)][both] - there[both]) < 0.01


def test_errors_of_the_estimate_reach_the_law() -> None:
    """It steers to where the estimate says that the path is: beside it by a bias that is drawn, and stated."""
    biased = PERFECT.model_copy(update={"bias": 0.12})
    env = vector("TrailerSteering-v0", 1, surrogate=biased, courses=("turn-90",), autoreset_mode="Disabled")
    pilot = LawPilot(env.core, load_vehicle("uk_longer_semitrailer"), "path_preview", biased)  # type: ignore[arg-type]
    (seen, info), aim = env.reset(seed=3, options={**NOMINAL, "sensor_error": 1.0}), []
    pilot.begin(features(seen))
    for _ in range(500):  # 28 m, straight to the turn
        seen, *_, info = env.step(pilot.act(features(seen), np.ones(1, dtype=bool)))
        aim.append(features(seen)[0, 0] - info["off_tracking"][0])
    bias = float(np.median(aim))
    assert abs(bias) > 0.05
    assert info["off_tracking"][0] == pytest.approx(-bias, abs=0.03)
