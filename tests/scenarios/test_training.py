"""Training: the plan, the curve, the comparison; and, with the extra, learning itself and going on with it."""

from __future__ import annotations

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

from controllers.trailer_steering.policy import Network, load_network
from offtrack.commands.cli import app
from offtrack.environments.rewards import Domain
from offtrack.environments.training import evaluation
from offtrack.environments.training.evaluation import CONDITIONS, Condition, scored
from offtrack.environments.training.training_directory import (
    COURSES,
    DOMAIN,
    Plan,
    Point,
    check_directory,
    draw_curve,
    normalisation,
    opened_directory,
    read_curve,
    write_curve,
)
from scenarios.progress import no_progress

needs_extra = pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None,
    reason="the extra rl is not installed: pip install 'offtrack[rl]'",
)


def point(steps: int, rms_m: float = 0.5) -> Point:
    """An update."""
    return Point(steps, 1e-3 * steps, 3, rms_m, 2.0 * rms_m, 0.0, -0.1, 0.2, 0.01, 0.9)


def test_what_is_called_unseen_is_not_in_the_training() -> None:
    """Courses, frictions and speeds of the conditions but the first, each in its own way."""
    conditions = {condition.name: condition for condition in CONDITIONS}
    assert set(conditions["courses"].courses).isdisjoint(COURSES)
    assert conditions["friction"].domain.friction[1] <= DOMAIN.friction[0]
    assert conditions["speed"].domain.speed[0] >= DOMAIN.speed[1]


def test_every_feature_has_a_usual_value() -> None:
    """The longest beginning that fits is what counts: the path's direction is no distance."""
    assert normalisation("path_direction") == (0.0, 0.25)
    assert normalisation("path_0.25_ahead") == (0.0, 1.0)
    assert normalisation("speed")[0] == normalisation("hitch_v_x")[0]


def test_a_curve_is_read_as_it_was_written_and_drawn(tmp_path: Path) -> None:
    """Updates in which no episode ended have no off-tracking, and no place in the picture."""
    curve = [point(1000, math.nan), point(2000), point(3000, 0.25)]
    write_curve(curve, tmp_path / "curve.parquet")
    assert str(read_curve(tmp_path / "curve.parquet")) == str(curve)
    draw_curve(curve, {"none": 1.0}, tmp_path / "curve.png")
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


def test_a_network_and_a_law_are_scored_in_the_same_episodes() -> None:
    """A network of zeros is what `none` is, to the last bit; command steer is another thing."""
    names = 18
    zeros = Network((np.zeros((2, names)),), (np.zeros(2),), np.zeros(names), np.ones(names), ("",) * names)
    short = Condition("short", "", ("turn-90",), Domain(speed=(5.5, 5.6), friction=(0.8, 0.9)))
    straight, none, linkage = (scored(Plan(), short, law, zeros, 1) for law in ("policy", "none", "command_steer"))
    assert straight == none
    assert none.mishaps == 0
    assert linkage.rms_m < 0.9 * none.rms_m


def test_without_the_extra_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """In one line, with exit code 2."""
    found = importlib.util.find_spec
    missing = ("stable_baselines3", "torch")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name in missing else found(name))
    result = CliRunner().invoke(app, ["train"])
    assert result.exit_code == 2
    assert "pip install 'offtrack[rl]'" in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.slow
@needs_extra
def test_a_training_is_gone_on_with_and_its_network_is_the_learners(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two updates, then two more by the same command; the arrays give the mean action of the checkpoint's model."""
    from stable_baselines3 import PPO

    short = Condition("trained", "short", ("turn-90",), Domain(speed=(5.5, 5.6), friction=(0.8, 0.9)))
    monkeypatch.setattr(evaluation, "CONDITIONS", (short,))
    monkeypatch.setattr(evaluation, "LAWS", ("none",))

    def told(steps: int, out: str) -> dict[str, object]:
        options = ["--envs", "8", "--episodes", "1", "--threads", "1", "--seed", "101", "--json"]
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
    assert set(kept["scores"]["trained"]) == {"policy", "none"}


class _Planted:
    """An object whose unpickling leaves a trace."""

    def __reduce__(self) -> tuple[Any, tuple[Path]]:
        return Path.touch, (Path("was here"),)


@pytest.mark.slow
@needs_extra
@pytest.mark.parametrize("place", ["policy_class", "observation_space", "policy.pth"])
def test_objects_in_a_checkpoint_are_not_unpickled(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither those in the model's description nor those among its tensors."""
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
        assert len(learn(plan, Budget(2048, None), directory, no_progress).curve) == 2
    assert not (tmp_path / "was here").exists()
