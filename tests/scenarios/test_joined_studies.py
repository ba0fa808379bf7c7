"""Studies that several commands make together: claims, takeover, plan, state and provenance."""

from __future__ import annotations

import json
import os
import threading
import time
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.studies.case import software
from offtrack.studies.claims import Claims

STUDY = """scenario = "cambered-road"
seeds = [1]
set.course.length = 20
set.off_tracking = "truth"
set.surface.roughness = "none"
[vary]
speed_kmh = [50, 60]
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def told(*arguments: str | Path, code: int = 0) -> str:
    answer = CliRunner().invoke(app, ["sweep", *map(str, arguments)])
    assert answer.exit_code == code, answer.output
    return answer.output


def test_only_one_gets_a_claim(tmp_path: Path) -> None:
    """Of many threads with claims of their own."""
    winners: list[int] = []

    def reach(k: int) -> None:
        if Claims(tmp_path).take("run"):
            winners.append(k)

    threads = [threading.Thread(target=reach, args=(k,)) for k in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(winners) == 1


def test_a_claim_that_shows_no_life_is_taken_over_and_a_kept_one_is_not(tmp_path: Path) -> None:
    """The watcher judges by changes that it sees itself: a time long past, of another clock, is none."""
    dead, living, watcher = Claims(tmp_path, 0.5), Claims(tmp_path, 0.5), Claims(tmp_path, 0.5)
    assert dead.take("left")
    assert living.take("kept")
    os.utime(tmp_path / "left.claim", (1.0, 1.0))
    assert not watcher.take("left")  # not seen for long enough
    with living.kept():
        end = time.monotonic() + 5.0
        while not watcher.take("left"):
            assert not watcher.take("kept")
            assert time.monotonic() < end
            time.sleep(0.05)
        assert not watcher.take("kept")
        dead.release("left")  # it comes back, and may not give up what is another's now
        assert not Claims(tmp_path).take("left")
    assert [claim.name for claim in watcher.all()] == ["left"]
    assert watcher.all()[0].process == os.getpid()
    watcher.release("left")
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("runs_here")
def test_runs_of_a_command_that_ended_are_made_by_another(study: Path, tmp_path: Path) -> None:
    """All runs and tables are there; the state before, and who made what; the value asked for is made again."""
    out = tmp_path / "out"
    began = json.loads(told(study, "--join", "--jobs", "1", "--out", out, "--json", "--quiet"))
    assert sum(row["completed"] for row in began) == 2
    cells = sorted((out / "cells").glob("*.json"))
    cells[0].unlink()
    assert Claims(out / "claims").take(cells[0].stem)  # of a process that will not go on
    state = json.loads(told(study, "--status", "--out", out, "--json"))
    assert (state["runs"], state["finished"], state["waiting"], len(state["running"])) == (2, 1, 0, 1)
    assert state["running"][0]["process"] == os.getpid()
    assert "process" in told(study, "--status", "--out", out)
    again = json.loads(told(study, "--join", "--lease", "1", "--jobs", "1", "--out", out, "--json", "--quiet"))
    assert again == began
    assert not list((out / "claims").iterdir())
    runs = pq.read_table(out / "runs.parquet").to_pylist()
    assert [(row["speed_kmh"], row["seed"]) for row in runs] == [("50", 1), ("60", 1)]
    assert all(row["host"] and row["cpu"] and row["seconds"] > 0.0 and row["engine"] for row in runs)
    assert len(pyarrow.csv.read_csv(out / "runs.csv")) == 2
    times = {path.name: path.stat().st_mtime_ns for path in cells}
    told(study, "--where", "speed_kmh=60", "--jobs", "1", "--out", out, "--quiet")
    assert sum(path.stat().st_mtime_ns != times[path.name] for path in cells) == 1
    assert "no run of the study has these values" in told(study, "--where", "speed_kmh=7", "--out", out, code=2)


def test_another_study_or_version_is_refused(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one line, before anything is changed."""
    from offtrack.studies.join import planned
    from offtrack.studies.study import load_study

    cases = load_study(study).cases()
    names = planned(cases, tmp_path)
    assert planned(cases, tmp_path) == names
    with pytest.raises(ValueError, match="another study, other files or another version of offtrack"):
        planned(cases[:1], tmp_path)
    monkeypatch.setattr("offtrack.studies.case.installed", lambda: ("another", "{}"))
    assert software()[0] == "another"
    with pytest.raises(ValueError, match="was begun on"):
        planned(cases, tmp_path)
    (tmp_path / "plan.json").write_text("{", encoding="utf-8")
    with pytest.raises(ValueError, match="is damaged: remove it"):
        planned(cases, tmp_path)
    assert "there is no study yet" in told(study, "--status", "--out", tmp_path / "none", code=2)
