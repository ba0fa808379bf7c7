"""Campaign files, which runs they ask for and how they are refused; and the command."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner, Result

from offtrack.commands.cli import app
from offtrack.studies.campaigns.campaign import Campaign, campaign_names, campaign_path, load_campaign, with_changes
from offtrack.studies.campaigns.fault_entry import FaultTime, fault_time
from offtrack.studies.campaigns.run_campaign import default_campaign
from offtrack.studies.campaigns.verdict import time_of

HEAD = """scenario = "roundabout"
seeds = [1, 2]
[set]
off_tracking = "surrogate"
[vary]
trailer_steering = ["path_preview", "mpc"]
surface.friction = [0.8, 0.3]
[requirements]
off_tracking.true_max_m = 0.5
steer.max_deg = { min = -1, max = 40 }
time_to_detect_s = 1
outcomes = ["completed", "timed out"]
"""


BIAS = '[[fault]]\nkind = "gyro_bias"\namounts = [1, 5]\nonsets = [6, 8]\ndurations = [2, "end"]\n'


DRAWN = """[[fault]]
kind = "dropout"
amounts.uniform = [0.2, 1]
onsets.uniform = [4, 7]
durations = [2]
[sample]
count = 8
"""


def campaign(tmp_path: Path, text: str) -> Campaign:
    path = tmp_path / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return load_campaign(path)


def test_lists_are_combined_and_the_reference_runs_once_for_each_law_and_seed(tmp_path: Path) -> None:
    """Two amounts, two onsets, two durations; two laws, two frictions, two seeds; and runs without a fault."""
    with pytest.raises(ValueError, match=r"^campaign [^\n]+: a table \[\[fault\]\] or \[pairs\] is missing"):
        campaign(tmp_path, HEAD)
    read = campaign(tmp_path, HEAD + BIAS)
    cases = read.cases()
    assert len(cases) == 8 * 8 + 8
    faults = [dict(case.axes)["faults"] for case in cases]
    assert faults.count("none") == 8
    assert set(faults) - {"none"} == {
        f"gyro_bias:{amount}@{onset}{duration}" for amount in "15" for onset in "68" for duration in ("+2", "")
    }
    assert (read.law, read.further) == ("trailer_steering", ("surface.friction",))
    assert campaign(tmp_path, read.to_toml()) == read


def test_an_entry_runs_with_its_seeds_and_values_alone_and_so_does_its_reference(tmp_path: Path) -> None:
    """``only`` and ``seeds`` take runs out; the reference of those goes with them."""
    only = 'only = { trailer_steering = "mpc", surface.friction = [0.3] }\nseeds = [2]\n'
    read = campaign(tmp_path, HEAD + BIAS + only)
    cases = read.cases()
    assert len(cases) == 8 + 1
    assert {(case.seed, *(value for _, value in case.axes[1:])) for case in cases} == {(2, "mpc", "0.3")}
    assert campaign(tmp_path, read.to_toml()) == read


def test_drawn_numbers_are_words_of_the_fault_and_the_reference_is_not_repeated(tmp_path: Path) -> None:
    """Each draw has an onset of whole milliseconds; runs without a fault are as many as there are seeds."""
    read = campaign(tmp_path, HEAD + DRAWN)
    cases = read.cases()
    references = [case for case in cases if dict(case.axes)["faults"] == "none"]
    assert (len(cases), len(references)) == (4 * 8 + 4 * 2, 4 * 2)
    (first, *_) = (case for case in cases if case not in references)
    fault = first.settings[-3]
    assert fault.startswith("faults=dropout:0.")
    time = time_of(first)
    assert time is not None
    assert time.end is not None
    assert time.onset == round(time.onset, 3)
    assert time.end == pytest.approx(time.onset + 2.0)
    assert len({time_of(case) for case in cases if case not in references}) == 8
    first.resolved()
    assert fault_time("dropout@3+1; gyro_bias:2@5+4") == FaultTime(3.0, 9.0)  # the first onset, the last end
    assert fault_time("dropout@3; gyro_bias:2@5+4") == FaultTime(3.0, None)
    assert fault_time("none") is None
    assert campaign(tmp_path, read.to_toml()).cases() == cases


def test_settings_and_seeds_of_the_command_replace_those_of_the_file(tmp_path: Path) -> None:
    """A key that the file varies is not varied any more."""
    read = campaign(tmp_path, HEAD + BIAS + "seeds = [2]\n")
    changed = with_changes(read, (("surface.friction", "0.5"),), (7,))
    assert {case.seed for case in changed.cases()} == {7}
    assert len(changed.cases()) == 2 * 9
    assert "surface.friction=0.5" in changed.cases()[0].settings
    only = campaign(tmp_path, HEAD + BIAS + "only.surface.friction = 0.3\n")
    assert len(with_changes(only, (("surface.friction", "0.3"),), None).cases()) == 2 * 2 * 9
    assert not with_changes(only, (("surface.friction", "0.8"),), None).cases()


def test_the_shipped_campaigns_have_what_they_say() -> None:
    """Faults with and without cameras, on two surfaces, for three laws; and of a rover's camera for two."""
    read = {name: load_campaign(path) for name in campaign_names() if (path := campaign_path(name))}
    values = {name: {axis for case in one.cases() for axis in case.axes} for name, one in read.items()}
    steering, cameras, rover = (
        values[f"{name}-faults"] for name in ("trailer-steering", "trailer-camera", "rover-camera")
    )
    assert {("off_tracking", name) for name in ("surrogate", "viso_ot")} <= steering
    assert {("surface.friction", number) for number in ("0.8", "0.3")} <= steering
    laws = {("trailer_steering", law) for law in ("path_preview", "mpc", "virtual_driver")}
    assert laws <= steering & cameras
    assert {("slip_compensation", law) for law in ("crab", "heading")} <= rover
    assert len(read["trailer-steering-faults"].cases()) > 360


FILE = """scenario = "roundabout"
seeds = [1]
set = { off_tracking = "truth", speed_kmh = 15, course = { entry = 20, turn_deg = 30, exit = 5 } }
vary.trailer_steering = ["path_preview"]
fault = [{ kind = "actuator_stuck", onsets = [5], durations = [1] }]
[requirements]
steer.max_deg = STEER
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


@pytest.mark.slow
@pytest.mark.usefixtures("runs_here")
def test_a_campaign_is_run_judged_and_reported_and_its_runs_are_used_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No failure in one run still allows 97.5 %; with another limit the same runs fail, and the exit code says so."""
    out, file = tmp_path / "out", tmp_path / "stuck.toml"
    file.write_text(FILE.replace("STEER", "45"), encoding="utf-8")
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
    file.write_text(FILE.replace("STEER", "1"), encoding="utf-8")
    monkeypatch.setenv("COLUMNS", "80")
    again = invoked(str(file), "--out", str(out), "--jobs", "1")
    assert again.exit_code == 1, again.output
    assert max(map(len, again.stdout.splitlines()[:6])) <= 80
    assert "1/1 3-100" in again.stdout
    assert "not accepted: actuator_stuck · path_preview: up to 100.0 %, allowed 98 %" in again.stdout
    assert "below 0.5" in again.stdout
    page = (out / "report.html").read_text(encoding="utf-8")
    words = ("Probability of failing", "3 to 100 % with 95 % confidence", "Clopper-Pearson", 'href="pages/2.html"')
    assert all(word in page for word in words)
    (_, stuck) = pq.read_table(out / "runs.parquet").to_pylist()
    assert (stuck["fault"], stuck["verdict"]) == ("actuator_stuck", "failed")
    assert stuck["reasons"].startswith("steer.max_deg = ")


QUICK = """scenario = "lane-change"
seeds = [1]
set = { off_tracking = "truth", speed_kmh = 60, course = { kind = "straight", length = 20 } }
vary.trailer_steering = ["none", "command_steer"]
fault = [{ kind = "gyro_bias", amounts = [2], onsets = [0.2] }]
requirements.off_tracking.true_max_m = 0.5
bisect = [{ fault = "gyro_bias", low = 0, high = 1, tolerance = 0.5, only = { trailer_steering = "none" } }]
"""


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_default_campaign_has_every_fault_that_the_scenario_can_have() -> None:
    """Without cameras no fault of images; onsets on the way into the turn and in it; three laws."""
    made = default_campaign("turn-90", (("off_tracking", "truth"),), None, None)
    kinds = {entry.kind for entry in made.entries}
    assert {"gyro_bias", "dropout", "actuator_stuck", "demand_delay"} <= kinds
    assert not {"blackout", "dirt", "desync"} & kinds
    assert len(made.cases()) == (2 * len(kinds) + 1) * 3 * 2
