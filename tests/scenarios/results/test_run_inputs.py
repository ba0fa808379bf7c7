"""Files and own modules that a run depended on are kept with it."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.options.scenario import load_scenario
from scenarios.results.log import read_log
from scenarios.results.run_inputs import RunInputs, run_inputs, texts, write_inputs

SHORT = ("course.length=20", "off_tracking=truth", "surface.roughness=none", "reference_unit=false")
LAW = """
from angles import ANGLE
from controllers.trailer import SteerCommand
import numpy as np

class Law:
    def __init__(self, *_, **__):
        pass
    def init(self):
        return None
    def step(self, memory, tick, off_tracking, signals):
        return None, SteerCommand(angles=np.full(len(signals.angles), ANGLE))
"""


def offtrack(*arguments: str) -> str:
    done = CliRunner().invoke(app, [*arguments, "--no-video", "--quiet"])
    assert done.exit_code == 0, done.stderr
    return done.stderr


def settings(*more: str) -> list[str]:
    return [f"--set={setting}" for setting in (*SHORT, *more)]


def test_a_run_directory_runs_again_elsewhere_and_after_its_vehicle_file_was_edited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scenario names the copy beside it; the original is gone."""
    monkeypatch.chdir(tmp_path)
    shipped = load_scenario("cambered-road").vehicle
    source = next(Path(__file__).parents[3].joinpath("vehicle").rglob(f"{shipped}.toml"))
    (tmp_path / "truck.toml").write_bytes(source.read_bytes())
    offtrack("run", "cambered-road", *settings("vehicle=truck.toml"), "--out", "a")
    assert (tmp_path / "a" / "inputs" / "truck.toml").read_bytes() == source.read_bytes()
    (tmp_path / "truck.toml").write_text("broken")
    (tmp_path / "elsewhere").mkdir()
    shutil.move(tmp_path / "a", tmp_path / "elsewhere" / "b")
    assert offtrack("run", "elsewhere/b/scenario.toml", "--out", "again") == ""
    logs = [read_log(folder / "signals.parquet") for folder in (tmp_path / "elsewhere" / "b", tmp_path / "again")]
    assert logs[0] == logs[1]


@pytest.mark.slow
def test_a_rerun_on_changed_own_modules_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of a module that the law's module imports; unchanged ones are passed over."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "kept_law.py").write_text(LAW)
    (tmp_path / "angles.py").write_text("ANGLE = 0.0")
    offtrack(
        "run",
        "cambered-road",
        *settings("trailer_steering=kept_law:Law", "vehicle=uk_longer_semitrailer"),
        "--out",
        "a",
    )
    manifest = json.loads((tmp_path / "a" / "manifest.json").read_text(encoding="utf-8"))
    assert set(manifest["own_modules"]) == {"kept_law", "angles"}
    assert offtrack("run", "a/scenario.toml", "--out", "b") == ""
    (tmp_path / "angles.py").write_text("ANGLE = 0.0  # edited")
    assert offtrack("run", "a/scenario.toml", "--out", "c") == (
        "offtrack: own module angles has changed since the run of a/scenario.toml: the results may be others\n"
    )


def test_files_of_equal_names_are_kept_apart(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.csv").write_text(folder)
    named = {"one": str(tmp_path / "a" / "x.csv"), "two": [{"three": str(tmp_path / "b" / "x.csv")}]}
    inputs = run_inputs({**named, "vehicle": "roundabout", "n": 3})
    assert sorted(inputs.files.values()) == [b"a", b"b"]
    toml = f'one = "{named["one"]}"\ntwo = [{{three = "{tmp_path / "b" / "x.csv"}"}}]\nn = 3\n'
    text = write_inputs(toml, inputs, tmp_path)
    assert 'one = "inputs/x.csv"' in text
    assert 'three = "inputs/1-x.csv"' in text
    assert (tmp_path / "inputs" / "1-x.csv").read_text() == "b"
    assert write_inputs(toml, RunInputs(), tmp_path) == toml
    assert list(texts({"a": {"b": ("c", ["d"])}, "e": 1})) == ["c", "d"]
