"""Grids of runs: what they are made of, that nothing finished is lost, and what they show."""

import csv
import hashlib
import json
import os
import re
import sys
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import offtrack
from offtrack.commands.cli import app
from offtrack.studies.case import Case, Outcome, listed, seeds_of
from offtrack.studies.pool import RunOptions, run_cases
from offtrack.studies.rehearsal import time_text
from offtrack.studies.run_study import check_study_directory, opened_study, run_study, study_text
from offtrack.studies.study import Study, load_study
from offtrack.studies.study_page import answer, study_page
from offtrack.studies.table import rows_of, table_csv
from scenarios.results.run_directory import digest
from vehicle.foundation.user_cache import warn_once

SHORT = (("course.length", "20"), ("off_tracking", "truth"), ("surface.roughness", "none"))  # half a second of driving


def study(**axes: tuple[str, ...]) -> Study:
    return Study(
        scenario="cambered-road",
        fixed=SHORT,
        axes={key.replace("__", "."): values for key, values in axes.items()},
        seeds=(1, 2),
    )


def test_a_grid_has_every_combination_once(tmp_path: Path) -> None:
    """Two frictions, three speeds, two seeds: twelve different runs; the same again from the study's file.

    A fixed setting of one study may be an axis of another.
    """
    written = study(surface__friction=("0.8", "0.3"), speed_kmh=("40", "60", "80"))
    identities = {case.identity() for case in written.cases()}
    assert len(identities) == len(written.cases()) == 12
    (tmp_path / "study.toml").write_text(written.to_toml())
    assert {case.identity() for case in load_study(tmp_path / "study.toml").cases()} == identities
    fixed = Case(scenario="cambered-road", fixed=(*SHORT, ("speed_kmh", "60")), axes=(), seed=1)
    axis = Case(scenario="cambered-road", fixed=SHORT, axes=(("speed_kmh", "60.0"),), seed=1)
    assert fixed.identity() == axis.identity()
    nested = "[" * 5000 + "]" * 5000  # the parser of TOML would recurse into it
    assert nested in study(speed_kmh=(nested,)).to_toml()


def test_lists_and_seeds_are_read_from_text_and_files(tmp_path: Path) -> None:
    """What is in brackets stays together; seeds may be ranges, as printers count pages."""
    assert listed("a,b", "--vary x") == ("a", "b")
    assert listed("[1, 2],[3, 4]", "--vary x") == ("[1, 2]", "[3, 4]")
    assert seeds_of("1-3,7") == (1, 2, 3, 7)
    for seeds in ("[-1]", "[true]", "[1, 1]", "[]"):
        (tmp_path / "study.toml").write_text(f'scenario = "roundabout"\nseeds = {seeds}\n[vary]\nspeed_kmh = [10]\n')
        with pytest.raises(ValueError, match=r"study\.toml: seeds"):
            load_study(tmp_path / "study.toml")


def saved(cells: Path, case: Case, outcome: str) -> Path:
    signals = cells / f"{case.identity()}.parquet"
    signals.write_bytes(b"signals")
    summary = {"outcome": outcome, "signals_sha256": hashlib.sha256(b"signals").hexdigest(), "files_sha256": {}}
    signals.with_suffix(".json").write_text(json.dumps(summary))
    return signals.with_suffix(".json")


@pytest.mark.usefixtures("runs_here")
def test_finished_runs_are_kept_and_damaged_ones_are_named_and_made_again(tmp_path: Path) -> None:
    """A summary in the folder stands for its run.

    Half a summary, one that is no summary, signals that are cut off: a line on each, and its run is repeated.
    """
    cases = study(speed_kmh=("60", "50")).cases()
    files = [saved(tmp_path, case, "from before") for case in cases]
    files[0].write_text(files[0].read_text()[:20])
    files[1].write_text("[1, 2]")
    files[2] = files[2].with_suffix(".parquet")
    files[2].write_bytes(b"sig")
    lines: list[str] = []
    outcomes = run_cases(cases, tmp_path, RunOptions(jobs=1, remark=lines.append))
    assert lines == [f"{file} is damaged: its run is repeated" for file in files[:3]]
    assert [outcome.numbers["outcome"] for outcome in outcomes] == [*["completed"] * 3, "from before"]
    assert not list(tmp_path.glob(".*"))


def test_only_regular_files_have_a_digest(tmp_path: Path) -> None:
    """A device or a pipe in the place of a saved file would be read for ever: its run counts as damaged."""
    (tmp_path / "whole").write_bytes(b"signals")
    (tmp_path / "device").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    assert digest(tmp_path / "whole") == hashlib.sha256(b"signals").hexdigest()
    assert [digest(tmp_path / name) for name in ("device", "pipe", "", "missing")] == [""] * 4


def test_a_directory_is_for_one_study_and_one_command(tmp_path: Path) -> None:
    """A second command is refused at once; the lock and the first file of a killed one do not matter.

    A user's file is a reason to refuse.
    """
    (tmp_path / ".study.toml.123.unfinished").touch()
    check_study_directory(tmp_path)
    with opened_study(tmp_path, "study.toml", ""), pytest.raises(ValueError, match="another process works in it"):
        opened_study(tmp_path, "study.toml", "").__enter__()
    with opened_study(tmp_path, "study.toml", ""):
        assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]
    (tmp_path / "study.toml").rename(tmp_path / "mine.toml")
    with pytest.raises(ValueError, match=r"holds no study\.toml"):
        check_study_directory(tmp_path)


@pytest.mark.usefixtures("runs_here")
def test_a_run_that_fails_does_not_end_the_study(tmp_path: Path) -> None:
    """An own controller's error is one line in the table, and is tried again the next time."""
    (tmp_path / "broken.py").write_text(
        "class Broken:\n    def __init__(self, trailer): pass\n    def init(self): return None\n"
        "    def step(self, *rest): raise RuntimeError('no idea')\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        patch.setattr("sys.path", list(sys.path))  # the catalogue adds the working directory
        cases = study(trailer_steering=("broken:Broken",)).cases()[:1]
        (outcome,) = run_cases(cases, tmp_path / "cells", RunOptions(jobs=1))
    assert str(outcome.numbers["outcome"]).endswith(
        "at tick 0 (0 s) it raised RuntimeError: no idea (broken.py, line 4)"
    )
    assert str(outcome.numbers["outcome"]).startswith("failed: ")
    assert not list((tmp_path / "cells").glob("*.json"))


@pytest.mark.slow
@pytest.mark.usefixtures("runs_here")
def test_runs_say_where_they_were_made_and_where_makes_some_again(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(study(speed_kmh=("50", "60")).to_toml())
    out = tmp_path / "out"

    def swept(*arguments: str, code: int = 0) -> str:
        command = ["sweep", str(tmp_path / "study.toml"), "--jobs", "1", "--out", str(out), "--quiet", *arguments]
        answer = CliRunner().invoke(app, command)
        assert answer.exit_code == code, answer.output
        return answer.output

    swept()
    runs = pq.read_table(out / "runs.parquet").to_pylist()
    assert [(row["speed_kmh"], row["seed"]) for row in runs] == [
        (speed, seed) for speed in ("50", "60") for seed in (1, 2)
    ]
    assert all(row["host"] and row["cpu"] and row["seconds"] > 0.0 and row["engine"] for row in runs)
    assert len(pyarrow.csv.read_csv(out / "runs.csv")) == 4
    times = {path: path.stat().st_mtime_ns for path in (out / "cells").glob("*.json")}
    swept("--where", "speed_kmh=60")
    assert sum(path.stat().st_mtime_ns != time for path, time in times.items()) == 2
    assert "no run of the study has these values" in swept("--where", "speed_kmh=7", code=2)


@pytest.mark.slow
def test_that_the_model_is_interpreted_is_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    warn_once.cache_clear()
    outcomes = run_cases(study(speed_kmh=("60",)).cases(), tmp_path, RunOptions(jobs=2))
    assert [outcome.numbers["outcome"] for outcome in outcomes] == ["completed", "completed"]
    assert len([message for message in caplog.messages if "vehicle models are interpreted" in message]) == 1
    assert "interpreted" not in capfd.readouterr().err


def made(case: Case, largest: float, *, outcome: str = "completed", clearance: float = 1.0) -> Outcome:
    numbers = {"off_tracking": {"true_max_m": largest}, "road": {"wheel_clearance_left_m": clearance}}
    return Outcome(case=case, numbers={"outcome": outcome, "steer": {"max_deg": 0.0}, **numbers})


def test_the_answer_names_the_best_law_of_each_condition_and_bold_is_what_is_better() -> None:
    """Runs that did not complete are not compared, ties are not bold, the least clearance counts."""
    grid = Study(
        scenario="roundabout",
        fixed=(),
        axes={"trailer_steering": ("none", "mpc"), "speed_kmh": ("10", "20", "30")},
        seeds=(1, 2),
    )
    largest = {("none", "10"): 1.8, ("mpc", "10"): 0.02, ("none", "20"): 0.5, ("mpc", "20"): 0.1}
    values = [(case, dict(case.axes)) for case in grid.cases()]
    cases = [(case, axes["trailer_steering"], axes["speed_kmh"]) for case, axes in values]
    outcomes = [
        made(
            case,
            largest.get((law, speed), 0.3),
            outcome="jackknifed" if (law, speed) == ("mpc", "20") else "completed",
            clearance=0.5 if case.seed == 2 and law == "none" else 1.0,
        )
        for case, law, speed in cases
    ]
    rows = rows_of(outcomes)
    assert answer(rows) == [
        "Speed 10 km/h: mpc has the smallest maximum true off-tracking, 2.0 cm (none 1.80 m).",
        "Speed 20 km/h: the maximum true off-tracking is none 50.0 cm, mpc 10.0 cm; mpc did not always complete the "
        "course.",
        "Speed 30 km/h: the maximum true off-tracking is 30.0 cm.",
    ]
    page = study_page("sweep-grid", grid, outcomes, rows)
    bold = re.findall(r'<td class="number best"[^>]*>([^<]*)<', page)
    assert sorted(bold) == ["0.020", "1.00", "1.00"]  # clearance: mpc at 10 and 30 km/h
    assert "<h1>grid</h1>" in page


def test_rows_are_root_mean_squares_and_largest_values_over_the_seeds() -> None:
    """RMS of 3 and 4 is sqrt(12.5), the largest of 1 and 2 is 2; a run that ended badly is told."""
    first, second = study(speed_kmh=("60",)).cases()
    outcomes = [
        Outcome(case=first, numbers={"outcome": "completed", "off_tracking": {"true_rms_m": 3.0, "true_max_m": 1.0}}),
        Outcome(case=second, numbers={"outcome": "jackknifed", "off_tracking": {"true_rms_m": 4.0, "true_max_m": 2.0}}),
    ]
    (row,) = rows_of(outcomes)
    assert row.numbers["off_tracking.true_rms_m"] == pytest.approx(12.5**0.5)
    assert row.numbers["off_tracking.true_max_m"] == 2.0
    assert (row.runs, row.completed, row.endings) == (2, 1, ("jackknifed",))
    (line,) = csv.DictReader(table_csv([row]).splitlines())
    assert (line["speed_kmh"], line["true_max_m"], line["endings"]) == ("60", "2.0", "jackknifed")


def test_a_study_in_its_own_directory_keeps_the_users_file(tmp_path: Path) -> None:
    """``offtrack sweep study.toml --out .``: comments stay, as long as it is the same study."""
    text = study(speed_kmh=("60",)).to_toml() + "# mine\n"
    (tmp_path / "study.toml").write_text(text)
    assert study_text(study(speed_kmh=("60",)), tmp_path) == text
    assert study_text(study(speed_kmh=("50",)), tmp_path) == study(speed_kmh=("50",)).to_toml()


@pytest.mark.usefixtures("runs_here")
def test_compare_writes_table_and_report(tmp_path: Path) -> None:
    out = tmp_path / "out"
    fixed = [part for key, value in SHORT if key != "off_tracking" for part in ("--set", f"{key}={value}")]
    arguments = ["compare", "cambered-road", "--controllers", "none,path_preview", "--json", "--out", str(out), *fixed]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.stderr
    rows = json.loads(result.stdout)
    assert [row["axes"]["trailer_steering"] for row in rows] == ["none", "path_preview"]
    assert all(row["completed"] == 1 for row in rows)
    tables = {f"{name}.{ending}" for name in ("table", "runs") for ending in ("csv", "parquet")}
    assert {path.name for path in out.iterdir()} == {"cells", "pages", "report.html", "study.toml", *tables}
    page = (out / "report.html").read_text()
    assert not any(f'{link}="http' in page for link in ("src", "href"))


def test_keys_of_a_study_may_be_quoted_dotted_or_nested(tmp_path: Path) -> None:
    texts = (
        '[set]\n"surface.friction" = 0.5\n[vary]\n"course.radius" = [12.0, 14.0]\n',
        "[set]\nsurface.friction = 0.5\n[vary]\ncourse.radius = [12.0, 14.0]\n",
        "[set.surface]\nfriction = 0.5\n[vary.course]\nradius = [12.0, 14.0]\n",
    )
    studies = []
    for k, text in enumerate(texts):
        (tmp_path / f"{k}.toml").write_text('scenario = "roundabout"\n' + text, encoding="utf-8")
        studies.append(load_study(tmp_path / f"{k}.toml"))
    assert studies[0] == studies[1] == studies[2]
    (tmp_path / "both.toml").write_text(
        'scenario = "roundabout"\n[vary]\n"course.radius" = [12.0]\ncourse.radius = [14.0]\n', encoding="utf-8"
    )
    with pytest.raises(ValueError, match=r"vary\.course\.radius must be one list"):
        load_study(tmp_path / "both.toml")


def test_a_law_with_a_file_of_parameters_is_that_law_with_them(tmp_path: Path) -> None:
    alone, whole = tmp_path / "alone.toml", tmp_path / "tuned.toml"
    alone.write_text("gain = 0.9\n", encoding="utf-8")
    whole.write_text('name = "x"\n[course]\nkind = "roundabout"\n[steering]\ngain = 0.9\n', encoding="utf-8")
    for file in (alone, whole):
        axes = (("trailer_steering", f"path_preview@{file}"),)
        case = Case(scenario="roundabout", fixed=(), axes=axes, seed=1)
        assert case.settings == ("trailer_steering=path_preview", "steering.gain=0.9")
    whole.write_text('[course]\nkind = "roundabout"\n', encoding="utf-8")
    with pytest.raises(ValueError, match=r"the file must hold the table \[steering\]"):
        _ = Case(scenario="roundabout", fixed=(), axes=(("trailer_steering", f"mpc@{whole}"),), seed=1).settings


@pytest.mark.slow
def test_finished_runs_are_compared_by_their_names(tmp_path: Path) -> None:
    settings = {"off_tracking": "truth", "course.turn_deg": 30.0, "course.entry": 20.0, "course.exit": 5.0}
    for name, law in (("first", "none"), ("second", "command_steer")):
        offtrack.run("roundabout", trailer_steering=law, settings=settings).save(tmp_path / name)
    arguments = ["compare", str(tmp_path / "first"), str(tmp_path / "second"), "--out", str(tmp_path / "both")]
    answer = CliRunner().invoke(app, [*arguments, "--json"])
    assert answer.exit_code == 0, answer.output
    rows = json.loads(answer.stdout)
    assert [row["axes"] for row in rows] == [{"run": "first"}, {"run": "second"}]
    known = json.loads((tmp_path / "second" / "summary.json").read_text(encoding="utf-8"))
    assert rows[1]["off_tracking.true_rms_m"] == known["off_tracking"]["true_rms_m"]
    page = (tmp_path / "both" / "report.html").read_text(encoding="utf-8")
    assert "second: uk_longer_semitrailer · trailer steering command_steer · off-tracking truth" in page
    assert re.search(r"<li>(first|second) has the smallest maximum true off-tracking", page)
    for wrong, line in (
        ([str(tmp_path / "first")], "give two or more finished runs"),
        ([str(tmp_path / "first")] * 2, "a run is named twice"),
        ([str(tmp_path / "first"), str(tmp_path)], "is no finished run: it has no summary.json"),
    ):
        refused = CliRunner().invoke(app, ["compare", *wrong])
        assert refused.exit_code == 2
        assert line in refused.stderr


def test_studies_have_numbered_directories_and_go_on_in_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another study replaces nothing, and takes runs that are the same from its neighbour; the same goes on."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.toml").write_text(
        'name = "own"\noff_tracking = "truth"\n[course]\nkind = "straight"\nlength = 20\n', encoding="utf-8"
    )

    def compared(*arguments: str) -> str:
        result = CliRunner().invoke(app, ["compare", "own.toml", "--controllers", "none", "--jobs", "1", *arguments])
        assert result.exit_code == 0, result.output
        return result.output

    assert "Report: runs/compare-own-1/report.html" in compared()
    first = (tmp_path / "runs/compare-own-1/report.html").read_bytes()
    assert "kept" not in compared("--seeds", "2")
    assert "2 runs, 1 kept from before, 1 left, 1 at a time" in compared("--seeds", "2,3")
    assert (tmp_path / "runs/compare-own-1/report.html").read_bytes() == first
    assert "Report: runs/compare-own-2/report.html" in compared("--seeds", "2")
    finished = json.loads(compared("--seeds", "2-4", "--status", "--json"))
    assert finished | {"seconds": 0} == {
        "directory": "runs/compare-own-4", "runs": 3, "kept": 0, "seconds": 0, "jobs": 1,
    }  # fmt: skip
    assert json.loads(compared("--seeds", "2,3", "--status", "--json"))["kept"] == 2
    scenario = (tmp_path / "own.toml").read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(scenario.replace("length = 20", "length = 21"), encoding="utf-8")
    assert "Report: runs/compare-own-4/report.html" in compared("--seeds", "2")  # the same words, other runs


def test_what_is_set_for_all_runs_is_what_is_compared_and_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = [part for key, value in SHORT for part in ("--set", f"{key}={value}")]
    arguments = [
        "compare",
        "cambered-road",
        *settings,
        "--set",
        "off_tracking=kinematic",
        "--set",
        "trailer_steering=none",
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "All runs: trailer_steering = none, off_tracking = kinematic" in result.stdout


def test_an_interrupt_says_what_is_kept_and_how_to_continue(tmp_path: Path) -> None:
    """The first finished run is kept; the interrupt comes with the second progress report."""
    reports = list[float]()

    def interrupted(done: float, total: float, note: str = "", /) -> None:
        reports.append(done)
        if done == 1:
            raise KeyboardInterrupt

    options = RunOptions(jobs=1, progress=interrupted)
    with pytest.raises(KeyboardInterrupt, match=r"1 of 4 runs are kept in .*out"):
        run_study("title", study(speed_kmh=("60", "61")), tmp_path / "out", options)
    assert reports[-1] == 1


@pytest.mark.parametrize(
    ("mean", "text"), [(0.2, "1 s"), (80.0, "80 s"), (600.0, "10 min"), (9e3, "2 h"), (9e5, "10 days")]
)
def test_times_are_told_roughly(mean: float, text: str) -> None:
    assert time_text(mean) == text
