"""Commands refuse at once: in one line, with exit code 2, and before anything is made."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.results.run_directory import appearing_at_once, check_run_directory, mark_interrupted

REFUSED = {
    "train --minutes nan --out out": "--minutes = nan min must be between 0.05 and 1e+06 min",
    "train --envs 1000000000 --out out": "--envs = 1000000000 must be between 1 and 100000",
    "train --seed -1 --out out": "--seed = -1 must be between 0 and",
    "estimate off-tracking images --rate nan --out out": "--rate",
    "estimate off-tracking images --camera-x nan --out out": "--camera-x = nan m must be between -100 and 100 m",
    "estimate slip images --estimator truth --out out": "--estimator truth",
    "calibrate images --square nan --out rig.toml": "--square = nan m must be between 0.0001 and 10 m",
    "calibrate images/image_0 --out nowhere/rig.toml": "nowhere/rig.toml: there is no folder nowhere to write in",
    "fit-surrogate images --out nowhere/fit.toml": "nowhere/fit.toml: there is no folder nowhere to write in",
    "tune roundabout --range gain=nan:1 --out out": "--range gain=nan:1: expected LOW:HIGH",
    "tune roundabout --seeds 1-100000000 --out out": "100000000 seeds; a study has at most 20000 runs",
    "sweep study.toml --jobs 0 --out out": "--jobs = 0 must be between 1 and 1024",
    "run roundabout --record out --out out": "one contains the other",
    "run roundabout --set course.kind=path --set course.file=bomb.gpx --out out": "bomb.gpx: line 1: a document type",
    "run roundabout --set course.kind=path --set course.file=units.csv --out out": "units.csv: line 2: x = 'm'",
    "run roundabout --set course.kind=opendrive --set course.file=cut.xodr --out out": "cut.xodr: not XML: line 1",
    "run roundabout --set surface.crg=empty.crg --out out": "empty.crg: not a readable OpenCRG file",
    "assess nobody --out out": "nobody",
    "reproduce nothing --out out": "unknown figure 'nothing'",
}

ROADS = {
    "bomb.gpx": '<!DOCTYPE gpx [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><gpx>&b;</gpx>',
    "units.csv": "x,y\nm,m\n1,2\n",
    "cut.xodr": "<OpenDRIVE><road",
    "empty.crg": "",
}


@pytest.mark.parametrize("command", REFUSED)
def test_a_refusal_is_one_line_and_makes_nothing(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for side in ("image_0", "image_1"):
        (tmp_path / "images" / side).mkdir(parents=True)
        (tmp_path / "images" / side / "000000.png").touch()
    (tmp_path / "study.toml").write_text('scenario = "roundabout"\n[vary]\nspeed_kmh = [10, 20]\n')
    for name, text in ROADS.items():
        (tmp_path / name).write_text(text)
    before = sorted(tmp_path.rglob("*"))
    result = CliRunner().invoke(app, command.split())
    assert result.exit_code == 2, result.output
    assert REFUSED[command] in result.stderr
    assert result.stderr.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_only_untouched_results_of_an_interrupted_command_are_replaced(tmp_path: Path) -> None:

    def written(text: str) -> None:
        with appearing_at_once(tmp_path / "out") as folder:
            (folder / "numbers.txt").write_text(text)
            mark_interrupted(folder)

    written("first")
    written("second one")
    assert (tmp_path / "out" / "numbers.txt").read_text() == "second one"
    (tmp_path / "out" / "note.txt").write_text("mine")
    with pytest.raises(ValueError, match="not empty"):
        check_run_directory(tmp_path / "out")
    (tmp_path / "out" / "note.txt").unlink()
    check_run_directory(tmp_path / "out")
    (tmp_path / "out" / "numbers.txt").write_text("improved")
    with pytest.raises(ValueError, match="not empty"):
        written("third")
    assert (tmp_path / "out" / "numbers.txt").read_text() == "improved"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_results_are_kept_if_their_directory_was_filled_meanwhile(tmp_path: Path) -> None:
    """Two commands of the same name at the same time: the second to end keeps its results, and says where."""

    def slow() -> None:
        with appearing_at_once(tmp_path / "out") as folder:
            (folder / "mine").touch()
            (tmp_path / "out").mkdir()
            (tmp_path / "out" / "another").touch()

    with pytest.raises(ValueError, match=r"the results are in .*out-1"):
        slow()
    assert {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")} == {
        "out", "out/another", "out-1", "out-1/mine",
    }  # fmt: skip
