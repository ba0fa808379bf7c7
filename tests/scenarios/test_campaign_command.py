"""`offtrack campaign`: from a file to the table, the exit code and the report; and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner, Result

from offtrack.commands.cli import app
from offtrack.studies.campaigns.default_campaign import default_campaign
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario

SHORT = ["off_tracking=truth", "speed_kmh=15", "course.entry=20", "course.turn_deg=30", "course.exit=5"]
FILE = """scenario = "roundabout"
seeds = [1]
[set]
off_tracking = "truth"
speed_kmh = 15
course.entry = 20
course.turn_deg = 30
course.exit = 5
[vary]
trailer_steering = ["path_preview"]
[[fault]]
kind = "actuator_stuck"
onsets = [5]
durations = [1]
[requirements]
steer.max_deg = {steer}
time_to_recover_s = 5
[accept]
probability = 0.98
[[bisect]]
fault = "actuator_stuck"
of = "duration"
low = 0.5
high = 1
tolerance = 0.4
"""


def invoked(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["campaign", *arguments])


@pytest.mark.usefixtures("runs_here")
def test_a_campaign_is_run_judged_and_reported_and_its_runs_are_used_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No failure in one run still allows 97.5 %; with another limit the same runs fail, and the exit code says so."""
    out, file = tmp_path / "out", tmp_path / "stuck.toml"
    file.write_text(FILE.format(steer=45), encoding="utf-8")
    first = invoked(str(file), "--out", str(out), "--jobs", "1", "--json")
    assert first.exit_code == 0, first.output
    found = json.loads(first.stdout)
    assert [(cell["fault"], cell["failed"], cell["runs"]) for cell in found["cells"]] == [
        ("none", 0, 1),
        ("actuator_stuck", 0, 1),
    ]
    assert found["cells"][1]["probability"] == [0.0, pytest.approx(0.975)]
    assert [(search["finding"], search["smallest"]) for search in found["bisections"]] == [("never fails", None)]

    def nothing(_: object, tasks: dict[str, object], **__: object) -> Iterator[tuple[str, str]]:
        assert not tasks
        yield from ()

    monkeypatch.setattr("offtrack.studies.pool.each_in_a_worker", nothing)
    file.write_text(FILE.format(steer=1), encoding="utf-8")
    monkeypatch.setenv("COLUMNS", "80")
    again = invoked(str(file), "--out", str(out), "--jobs", "1")
    assert again.exit_code == 1, again.output
    assert max(map(len, again.stdout.splitlines()[:6])) <= 80
    assert "1/1 3-100" in again.stdout
    assert "not accepted: actuator_stuck · path_preview: up to 100.0 %, allowed 98 %" in again.stdout
    assert "below 0.5" in again.stdout
    page = (out / "report.html").read_text(encoding="utf-8")
    for words in (
        "Probability of failing",
        "3 to 100 % with 95 % confidence",
        "Clopper-Pearson",
        'href="pages/2.html"',
    ):
        assert words in page
    (_, stuck) = pq.read_table(out / "runs.parquet").to_pylist()
    assert (stuck["fault"], stuck["verdict"]) == ("actuator_stuck", "failed")
    assert stuck["reasons"].startswith("steer.max_deg = ")


QUICK = """scenario = "lane-change"
seeds = [1]
[set]
off_tracking = "truth"
speed_kmh = 60
course.kind = "straight"
course.length = 20
[vary]
trailer_steering = ["none", "command_steer"]
[[fault]]
kind = "gyro_bias"
amounts = [2]
onsets = [0.2]
[requirements]
off_tracking.true_max_m = 0.5
[[bisect]]
fault = "gyro_bias"
low = 0
high = 1
tolerance = 0.5
only.trailer_steering = "none"
"""


def test_an_interrupted_campaign_and_its_bisection_are_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is interrupted after two runs; the next command makes the others. What --where names is made again."""
    (tmp_path / "quick.toml").write_text(QUICK, encoding="utf-8")
    command = (str(tmp_path / "quick.toml"), "--jobs", "1", "--json", "--out")
    made, most = list[str](), [2]

    def each_here(work: Any, tasks: Any, **_: object) -> Iterator[tuple[str, str]]:
        for name, arguments in tasks.items():
            if len(made) == most[0]:
                raise KeyboardInterrupt
            made.append(name)
            yield name, work(*arguments)

    monkeypatch.setattr("offtrack.studies.pool.each_in_a_worker", each_here)
    out = tmp_path / "out"
    assert invoked(*command, str(out)).exit_code == 130
    assert len([*(out / "cells").glob("*.json")]) == 2
    most[0] = 100
    ended = invoked(*command, str(out))
    assert ended.exit_code == 0, ended.output
    assert len(made) == len(set(made)) == 6  # four runs, and both ends of the bisection
    again = invoked(*command, str(out), "--where", "trailer_steering=none")
    assert len(made) == 6 + 4
    assert json.loads(again.stdout) == json.loads(ended.stdout)
    whole = invoked(*command, str(tmp_path / "whole"))
    assert json.loads(whole.stdout) == json.loads(ended.stdout)
    assert invoked(*command, str(out), "--where", "trailer_steering=mpc").exit_code == 2


def test_a_fault_that_a_scenario_cannot_have_is_refused_before_any_run(tmp_path: Path) -> None:
    """There are no images without cameras."""
    file = tmp_path / "dark.toml"
    file.write_text(FILE.format(steer=45).partition("[[bisect]]")[0].replace("actuator_stuck", "blackout"), "utf-8")
    refused = invoked(str(file), "--out", str(tmp_path / "out"))
    assert refused.exit_code == 2
    assert refused.stderr.count("\n") == 1
    assert "fault blackout: blackout needs a camera" in refused.stderr
    assert not (tmp_path / "out").exists()


def test_an_unknown_name_is_refused_with_the_nearest(tmp_path: Path) -> None:
    assert "did you mean 'trailer-steering-faults'" in invoked("trailer-steering-fault").stderr
    assert "did you mean 'roundabout'" in invoked("roundabuot").stderr
    assert (
        "did you mean 'scenario'" in invoked(str(_written(tmp_path, "scenari = 1\n[[fault]]\nkind = 'dropout'"))).stderr
    )


def _written(folder: Path, text: str) -> Path:
    (folder / "wrong.toml").write_text(text, encoding="utf-8")
    return folder / "wrong.toml"


def test_the_default_campaign_has_every_fault_that_the_scenario_can_have() -> None:
    """Without cameras no fault of images; onsets on the way into the turn and in it; three laws."""
    made = default_campaign("turn-90", (("off_tracking", "truth"),), None, None)
    kinds = {entry.kind for entry in made.entries}
    assert {"gyro_bias", "dropout", "actuator_stuck", "demand_delay"} <= kinds
    assert not {"blackout", "dirt", "desync"} & kinds
    assert len(made.cases()) == (2 * len(kinds) + 1) * 3 * 2


def test_the_log_of_a_run_with_faults_says_what_the_guard_does() -> None:
    """Messages are lost from 4 s to 5.5 s: the guard hands over within a second or so, and back some time later."""
    log = run(load_scenario("roundabout", [*SHORT, "faults=dropout:1@4+1.5"]), 1).log
    steering = log["time"][log["fallback"] > 0.0]
    assert 4.2 < steering[0] < 5.3
    assert steering[-1] > 5.5
    biased = run(load_scenario("roundabout", [*SHORT, "faults=wheel_speed_dropout@4+1"]), 1).log
    assert 4.0 < biased["time"][biased["distrusted"] > 0.0][0] < 5.0
    assert "fallback" not in run(load_scenario("roundabout", SHORT), 1).log
