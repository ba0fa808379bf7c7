"""Tuning: trials that survive, and what is chosen of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from scenarios.cli import app
from scenarios.options.scenario import load_scenario
from scenarios.studies.tuning import Trial, chosen, pareto


def trial(number: int, *values: float) -> Trial:
    return Trial(number=number, parameters={"gain": float(number)}, values=values)


def test_the_front_is_what_no_other_trial_beats() -> None:
    """(1, 3), (2, 2) and (3, 1) trade one objective for the other; (3, 3) and (2, 4) are beaten by (2, 2)."""
    trials = [trial(0, 3.0, 3.0), trial(1, 1.0, 3.0), trial(2, 2.0, 2.0), trial(3, 3.0, 1.0), trial(4, 2.0, 4.0)]
    assert [t.number for t in pareto(trials)] == [1, 2, 3]


def test_the_chosen_trial_is_a_compromise_whatever_the_units() -> None:
    """The middle of a front that bends towards the origin, with one objective in millimetres."""
    trials = [trial(0, 1.0, 3000.0), trial(1, 1.4, 1300.0), trial(2, 3.0, 1000.0)]
    assert chosen(trials).number == 1


def arguments(out: Path, trials: int) -> list[str]:
    course = ["course.turn_deg=30", "course.entry=20", "course.exit=5", "speed_kmh=20"]
    short = [*course, "off_tracking=truth", "reference_unit=false"]
    fixed = [part for setting in short for part in ("--set", setting)]
    sets = ["--seeds", "11", "--judge-seeds", "12", "--range", "gain=0.1:1.0", "--jobs", "1"]
    return ["tune", "roundabout", "--trials", str(trials), *sets, *fixed, "--json", "--out", str(out)]


def test_trials_are_gone_on_with_and_the_defaults_come_first(tmp_path: Path) -> None:
    """Two trials, then three in the same directory: the first two are those of before, the first has the defaults."""
    out = tmp_path / "out"
    first = CliRunner().invoke(app, arguments(out, 2))
    assert first.exit_code == 0, first.stderr
    kept = (out / "trials.csv").read_text().splitlines()
    second = CliRunner().invoke(app, arguments(out, 3))
    assert second.exit_code == 0, second.stderr
    assert (out / "trials.csv").read_text().splitlines()[: len(kept)] == kept
    assert len((out / "trials.csv").read_text().splitlines()) == 4
    assert kept[1].startswith("0,0.77,")  # the gain that path_preview ships with
    told = json.loads(second.stdout)
    assert set(told["judged"]) == {"defaults", "tuned"}
    assert load_scenario(str(out / "tuned.toml")).steering["gain"] == told["parameters"]["gain"]


def test_another_question_does_not_go_into_the_same_journal(tmp_path: Path) -> None:
    """Trials of other ranges or runs would be compared with these."""
    (tmp_path / "journal.log").touch()
    (tmp_path / "tuning.toml").write_text('law = "another"\n')
    result = CliRunner().invoke(app, arguments(tmp_path, 2))
    assert result.exit_code == 2
    assert "belongs to another tuning task" in result.stderr


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (["--range", "gian=0:1"], "path_preview has no such parameter; did you mean 'gain'?"),
        (["--range", "gain=1:0"], "--range gain=1:0: expected LOW:HIGH"),
        (["--objectives", "off_tracking.true_rms"], "no such summary metric"),
    ],
)
def test_what_can_not_be_tuned_is_one_line(changed: list[str], said: str, tmp_path: Path) -> None:
    """Exit code 2, and no directory is made."""
    result = CliRunner().invoke(app, [*arguments(tmp_path / "out", 2), *changed])
    assert result.exit_code == 2
    assert said in result.stderr
    assert not (tmp_path / "out").exists()
