"""Tuning: trials that survive, in a journal or in a database that machines share, and what is chosen of them."""

import json
import os
import platform
import re
import sqlite3
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.studies.study import Study
from offtrack.studies.trials import (
    database,
    finished,
    former,
    hidden,
    in_database,
    patiently,
    resume,
    study_name,
    work,
)
from offtrack.studies.tuning import Range, Trial, Tuning, chosen, pareto, tuning_page
from scenarios.options.scenario import load_scenario
from scenarios.results.run_directory import digest

SHORT = ("course.turn_deg=30", "course.entry=20", "course.exit=5", "speed_kmh=20", "off_tracking=truth")


def trial(number: int, *values: float) -> Trial:
    return Trial(number=number, parameters={"gain": float(number)}, values=values)


def test_the_front_is_what_no_other_trial_beats_and_a_compromise_is_chosen() -> None:
    """(1, 3), (2, 2) and (3, 1) trade one objective for the other; (3, 3) and (2, 4) are beaten by (2, 2)."""
    trials = [trial(0, 3.0, 3.0), trial(1, 1.0, 3.0), trial(2, 2.0, 2.0), trial(3, 3.0, 1.0), trial(4, 2.0, 4.0)]
    assert [t.number for t in pareto(trials)] == [1, 2, 3]
    millimetres = [trial(0, 1.0, 3000.0), trial(1, 1.4, 1300.0), trial(2, 3.0, 1000.0)]
    assert chosen(millimetres).number == 1  # the middle of a front that bends towards the origin


def test_a_page_says_if_nothing_is_better_than_the_defaults() -> None:
    """Better in one objective and worse in another is not better; importances come with labels and units."""
    pair = tuning("x", objectives=("off_tracking.true_rms_m", "off_tracking.true_max_m"))
    trials = [trial(0, 0.01, 0.05), trial(1, 0.02, 0.04)]
    importances = {name: {"gain": 0.25} for name in pair.objectives}
    pages = [
        tuning_page(pair, trials, trials[0], {"defaults": (0.01, 0.05), "tuned": tuned}, importances)
        for tuned in ((0.01, 0.05), (0.005, 0.05), (0.005, 0.06))
    ]
    verdicts = ["nothing better than the defaults", "better than the defaults", "nothing better than the defaults"]
    assert [re.findall(r'<span class="outcome[^>]*>(.*?)</span>', page)[0] for page in pages] == verdicts
    assert "Nothing better than the defaults was found; they are kept." in pages[0]
    assert "True off-tracking, RMS: 5.0 mm with the tuned parameters, 1.0 cm with the defaults (-50 %), " in pages[1]
    assert "True off-tracking, maximum [m]" in pages[0]
    assert "25 %" in pages[0]


def arguments(out: Path, trials: int) -> list[str]:
    fixed = [part for setting in (*SHORT, "reference_unit=false") for part in ("--set", setting)]
    sets = ["--seeds", "11", "--judge-seeds", "12", "--range", "gain=0.1:1.0", "--jobs", "1"]
    return ["tune", "roundabout", "--trials", str(trials), *sets, *fixed, "--json", "--out", str(out)]


@pytest.mark.slow
@pytest.mark.usefixtures("runs_here")
def test_trials_are_gone_on_with_and_the_defaults_come_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One trial, then two in the same directory: the first is that of before, and has the defaults."""
    monkeypatch.chdir(tmp_path)  # files of the working directory count, those of the study excepted
    out = tmp_path / "out"
    first = CliRunner().invoke(app, arguments(out, 1))
    assert first.exit_code == 0, first.stderr
    kept = (out / "trials.csv").read_text().splitlines()
    second = CliRunner().invoke(app, arguments(out, 2))
    assert second.exit_code == 0, second.stderr
    assert second.stderr == ""  # no trial is dropped
    assert (out / "trials.csv").read_text().splitlines()[: len(kept)] == kept
    assert len((out / "trials.csv").read_text().splitlines()) == 3
    assert kept[1].startswith("0,0.77,")  # the gain that path_preview ships with
    told = json.loads(second.stdout)
    assert set(told["judged"]) == {"defaults", "tuned"}
    assert load_scenario(str(out / "tuned.toml")).steering["gain"] == told["parameters"]["gain"]


def tuning(identity: str, **changes: Any) -> Tuning:
    runs = Study(scenario="roundabout", fixed=(), axes={}, seeds=(1,))
    plain = Tuning(
        law="path_preview", ranges={"gain": Range(low=0.0, high=1.0)}, defaults={"gain": 0.77}, objectives=("a",),
        tuned_on=runs, judged_on=runs, identity=identity,
    )  # fmt: skip
    return replace(plain, **changes)


def stored(directory: Path, name: str) -> optuna.Study:
    storage = JournalStorage(JournalFileBackend(str(directory / "journal.log")))
    return optuna.create_study(study_name=name, storage=storage, directions=["minimize"], load_if_exists=True)


def finish(study: optuna.Study, files: dict[str, str]) -> None:
    one = study.ask()
    one.suggest_float("gain", 0.0, 1.0)
    one.set_user_attr("files_sha256", files)
    study.tell(one, 1.0)


def test_trials_with_another_law_or_other_files_do_not_mix(tmp_path: Path) -> None:
    """They stay in the journal and are counted; a file that trials opened by themselves counts when they go on."""
    (tmp_path / "table.txt").write_text("1")
    finish(stored(tmp_path, study_name(tuning("old"))), {})
    finish(stored(tmp_path, study_name(tuning("new"))), {str(tmp_path / "table.txt"): digest(tmp_path / "table.txt")})
    assert former(tuning("new"), tmp_path) == 1
    resume(tuning("new"), tmp_path)
    assert len(finished(tuning("new"), tmp_path)) == 1
    (tmp_path / "table.txt").write_text("2")
    assert former(tuning("new"), tmp_path) == 2
    resume(tuning("new"), tmp_path)
    assert finished(tuning("new"), tmp_path) == []
    assert len(finished(tuning("old"), tmp_path)) == 1


def test_what_killed_workers_left_in_a_journal_does_not_stop_the_next(tmp_path: Path) -> None:
    """A trial that runs for ever, half a line, and a lock: the trial is tried again with its parameters."""
    study = stored(tmp_path, study_name(tuning("new")))
    finish(study, {})
    killed = study.ask().suggest_float("gain", 0.0, 1.0)
    with (tmp_path / "journal.log").open("a") as file:
        file.write('{"op_code":')
    (tmp_path / "journal.log.lock").symlink_to("journal.log")
    resume(tuning("new"), tmp_path)
    (tmp_path / "journal.log.lock").unlink()  # the next lines would wait for it
    states = [trial.state.name for trial in stored(tmp_path, study_name(tuning("new"))).trials]
    assert states == ["COMPLETE", "FAIL", "WAITING", "WAITING"]  # the parameters of before, the defaults
    assert stored(tmp_path, study_name(tuning("new"))).trials[2].system_attrs["fixed_params"] == {"gain": killed}
    assert len(finished(tuning("new"), tmp_path)) == 1


@pytest.mark.parametrize("damage", ["{\n", '1 {"op_code": 0}\n', '{"op_code": 4}\n', "\x00\n"])
def test_a_damaged_journal_is_named_and_nothing_is_written(damage: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "journal.log").write_text(damage)
    result = CliRunner().invoke(app, arguments(out, 2))
    assert result.exit_code == 2, result.output
    assert f"{out / 'journal.log'} is damaged" in result.stderr
    assert result.stderr.count("\n") == 1
    assert [path.name for path in out.iterdir()] == ["journal.log"]


def test_a_trial_without_its_parameters_is_a_damaged_journal(tmp_path: Path) -> None:
    finish(stored(tmp_path, study_name(tuning("new"))), {})
    path = tmp_path / "journal.log"
    path.write_text("".join(line for line in path.read_text().splitlines(True) if '"param_name"' not in line))
    with pytest.raises(ValueError, match=r"journal\.log is damaged \(ValueError: trial 0 has no gain\)"):
        former(tuning("new"), tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Heartbeat of storage")  # of trials that the test begins by itself
def test_trials_in_a_database_are_shared_and_dead_ones_are_tried_again(tmp_path: Path) -> None:
    """The trial of a process that has ended is failed at once, and its parameters are the next; the others' are not."""
    fixed = tuple((key, value) for key, _, value in (setting.partition("=") for setting in SHORT))
    runs = Study(scenario="roundabout", fixed=fixed, axes={}, seeds=(1,))
    parts: dict[str, Any] = {"objectives": ("off_tracking.true_rms_m",), "tuned_on": runs, "judged_on": runs}
    one = tuning(runs.identity(), ranges={"gain": Range(low=0.1, high=1.0)}, **parts)
    task = in_database(one, f"sqlite:///{tmp_path / 'trials.db'}")
    other = in_database(replace(task, ranges={"gain": Range(low=0.1, high=2.0)}), task.storage or "")
    assert task.shared_name != other.shared_name  # other ranges, other trials; the machine does not count
    assert in_database(task, task.storage or "").shared_name == task.shared_name
    resume(task, tmp_path)
    study = optuna.load_study(study_name=study_name(task), storage=database(task.storage or ""))
    assert study.study_name.startswith("roundabout-path_preview-")  # as dashboards list it
    assert study.metric_names == ["off_tracking.true_rms_m"]
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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Heartbeat of storage")
@pytest.mark.parametrize("gone", ["locked", "locked for long", "deleted"])
def test_a_database_that_is_locked_or_gone_is_waited_for_and_then_one_line(
    gone: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Locked between two calls for 8 s, of which SQLite itself waits 5; then for longer than the patience."""
    monkeypatch.setattr("offtrack.studies.trials.PATIENCE", 20.0 if gone == "locked" else 2.0)
    file = tmp_path / f"{gone}.db"
    task = replace(tuning("x", ranges={"gain": Range(low=0.1, high=1.0)}), storage=f"sqlite:///{file}")
    storage = database(task.storage or "")
    storage.get_all_studies()
    lock = sqlite3.connect(file, check_same_thread=False)
    lock.execute("BEGIN EXCLUSIVE")
    timer = threading.Timer(8.0 if gone == "locked" else 30.0, lock.rollback)
    if gone == "deleted":
        lock.rollback()
        file.unlink()
        storage.engine.dispose()
    timer.start()
    if gone == "locked":
        assert patiently(task, lambda: finished(task, tmp_path)) == []
    else:
        line = rf"^--storage sqlite:///{file}: the database can not be used: .*(locked|no such table)"
        with pytest.raises(ValueError, match=line) as refused:
            patiently(task, lambda: finished(task, tmp_path))
        assert "\n" not in str(refused.value)
    timer.cancel()
    timer.join()
    lock.close()


@pytest.mark.slow
def test_a_journal_gets_as_many_trials_as_asked_for_by_any_number_of_jobs(tmp_path: Path) -> None:
    """The last worker to begin one would make a trial too many."""
    done = CliRunner().invoke(app, [*arguments(tmp_path / "out", 3), "--jobs", "2"])
    assert done.exit_code == 0, done.output
    assert len((tmp_path / "out" / "trials.csv").read_text().splitlines()) == 1 + 3


def test_a_password_is_never_shown() -> None:
    url = "postgresql://me:s3cr:t@host:5432/trials"
    assert hidden(url) == "postgresql://me:***@host:5432/trials"
    assert hidden("postgresql://me@host/trials") == "postgresql://me@host/trials"
    assert "s3cr" not in repr(replace(tuning(""), storage=url))
