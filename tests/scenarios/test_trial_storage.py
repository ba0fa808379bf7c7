"""Tuning in a database that machines share: dead trials, passwords, refusals."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("sqlalchemy")

from offtrack.commands.cli import app
from offtrack.studies.study import Study
from offtrack.studies.trials import database, finished, hidden, in_database, resume, work
from offtrack.studies.tuning import Range, Tuning

SHORT = {"course.turn_deg": "30", "course.entry": "20", "course.exit": "5", "speed_kmh": "20", "off_tracking": "truth"}


def tuning(folder: Path) -> Tuning:
    runs = Study(scenario="roundabout", fixed=tuple(SHORT.items()), axes={}, seeds=(1,))
    one = Tuning(
        law="path_preview", ranges={"gain": Range(low=0.1, high=1.0)}, defaults={"gain": 0.77},
        objectives=("off_tracking.true_rms_m",), tuned_on=runs, judged_on=runs, identity=runs.identity(),
    )  # fmt: skip
    return in_database(one, f"sqlite:///{folder / 'trials.db'}")


@pytest.mark.filterwarnings("ignore:Heartbeat of storage")  # of trials that the test begins by itself
def test_trials_in_a_database_are_shared_and_dead_ones_are_tried_again(tmp_path: Path) -> None:
    """The trial of a process that has ended is failed at once, and its parameters are the next; the others' are not."""
    import optuna

    task = tuning(tmp_path)
    resume(task, tmp_path)
    study = optuna.load_study(study_name=f"tuning-{task.shared_name}", storage=database(task.storage or ""))
    study.ask()  # the defaults: of a process on another machine, which goes on
    left = study.ask({"gain": optuna.distributions.FloatDistribution(0.1, 1.0)})
    left.set_user_attr("process", [platform.node(), 2**22 + 7])  # above the largest number of a process
    work(task, tmp_path, 1, 1)
    states = [trial.state.name for trial in study.trials]
    assert states == ["RUNNING", "FAIL", "COMPLETE"]
    assert study.trials[2].params == left.params
    assert study.trials[2].user_attrs["process"] == [platform.node(), os.getpid()]
    (trial,) = finished(task, tmp_path / "elsewhere")
    assert trial.values == tuple(study.trials[2].values)


def test_another_task_has_other_trials(tmp_path: Path) -> None:
    """Of other ranges or objectives in the same database; the machine does not count."""
    from dataclasses import replace

    task = tuning(tmp_path)
    other = in_database(replace(task, ranges={"gain": Range(low=0.1, high=2.0)}), task.storage or "")
    assert task.shared_name != other.shared_name
    assert in_database(task, task.storage or "").shared_name == task.shared_name


def test_a_password_is_never_shown() -> None:
    """Neither in the representation of a task nor in messages."""
    url = "postgresql://me:s3cr:t@host:5432/trials"
    assert hidden(url) == "postgresql://me:***@host:5432/trials"
    assert hidden("postgresql://me@host/trials") == "postgresql://me@host/trials"
    runs = Study(scenario="roundabout", fixed=(), axes={}, seeds=(1,))
    task = Tuning(
        law="x", ranges={}, defaults={}, objectives=(), tuned_on=runs, judged_on=runs, identity="", storage=url
    )
    assert "s3cr" not in repr(task)


@pytest.mark.parametrize(
    ("url", "line"),
    [
        ("mysql://me:s3cret@host/x", "expected postgresql://"),
        ("postgresql://me:s3cret@127.0.0.1:1/x?connect_timeout=2", "the database can not be used"),
        ("nonsense", "expected postgresql://"),
        ("sqlite:////no/such/folder/x.db", "the database can not be used"),
        ("postgresql:x", "is no address"),
    ],
)
def test_a_database_that_can_not_be_used_is_one_line(url: str, line: str, tmp_path: Path) -> None:
    """Exit code 2, nothing is made."""
    fixed = [part for key, value in SHORT.items() for part in ("--set", f"{key}={value}")]
    result = CliRunner().invoke(app, ["tune", "roundabout", *fixed, "--storage", url, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert line in result.stderr
    assert "s3cret" not in result.output
    assert len(result.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()
