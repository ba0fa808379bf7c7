"""``import offtrack``: runs, sweeps and sessions from Python."""

import copy
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import offtrack
from tests.in_process import make_runs_here

ROOT = Path(__file__).resolve().parents[2]
SHORT = {"course.length": 20, "off_tracking": "truth", "surface.roughness": "none", "reference_unit": False}


@pytest.fixture(scope="module")
def run() -> offtrack.Run:
    return offtrack.run("cambered-road", seed=3, settings=SHORT, surface__cross_fall=0.02)


def test_a_run_has_its_numbers_and_signals(run: offtrack.Run) -> None:
    assert run.outcome == run.summary["outcome"] == "completed"
    assert run.summary["seed"] == 3
    assert repr(run) == "<run of cambered-road, seed 3: completed>"
    assert run["off_tracking_true"].shape == run["time"].shape
    with pytest.raises(KeyError, match="no signal 'speed'"):
        run["speed"]


def test_a_table_of_pandas_knows_units(run: offtrack.Run) -> None:
    table = run.to_pandas()
    assert table.index.name == "time"
    np.testing.assert_array_equal(table["y_tractor"].to_numpy(), run["y_tractor"])
    assert table.attrs["units"]["y_tractor"] == "m"
    assert table.attrs["descriptions"]["gear"] == "+1 forward, -1 backward"


def test_a_notebook_shows_the_numbers_with_units_and_without_markup_of_others(run: offtrack.Run) -> None:
    assert "offtrack/RoverSteering-v0" in gymnasium.registry  # the import registers the environments
    html = run._repr_html_()
    assert "cambered-road, seed 3: completed" in html
    assert "True off-tracking, RMS" in html
    sly = offtrack.Run({**run.summary, "outcome": "<b>", "warnings": ["<i>"]}, run.log, None, None)._repr_html_()
    assert "<b>" not in sly
    assert "<i>" not in sly


def test_a_saved_run_is_loaded_again(run: offtrack.Run, tmp_path: Path) -> None:
    run.save(tmp_path / "a")
    again = offtrack.load_run(tmp_path / "a")
    assert again.log == run.log
    assert again.summary == run.summary
    with pytest.raises(ValueError, match="copy that directory"):
        again.save(tmp_path / "b")
    (tmp_path / "a" / "summary.json").write_text("[1]")
    with pytest.raises(ValueError, match=r"summary\.json: must hold a JSON object"):
        offtrack.load_run(tmp_path / "a")


SMALL = {"rig.width": 480, "rig.height": 200, "course.length": 20, "world.scenery_density": 0.1}


@pytest.mark.parametrize(
    ("scenario", "settings", "seconds"),
    [
        ("cambered-road", SHORT, 0.5),
        pytest.param("constant-slip", SMALL, 0.5, marks=pytest.mark.slow),  # the renderer is shared
        ("rover-slope", {"course.length": 1.0, "slip_estimator": "truth"}, 1.0),
    ],
)
def test_a_snapshot_goes_on_like_its_original(
    scenario: str, settings: dict[str, float | str | bool], seconds: float
) -> None:
    """Bitwise; what one of them does is nothing to the other."""
    with offtrack.Session(scenario, settings=settings) as session:
        assert session.step(seconds)
        assert session.time == pytest.approx(seconds)
        assert session.truth.tick == round(1000 * seconds)
        snapshot = copy.deepcopy(session)
        session.step(seconds)
        assert snapshot.time == pytest.approx(seconds)
        assert snapshot.outcome is None
        snapshot.step(seconds)
        assert session.estimate is not None
        assert session.result().log == snapshot.result().log
        if scenario == "cambered-road":
            ahead = session.run()
            assert snapshot.run().log == ahead.log
            assert not session.step()
            assert ahead.log == offtrack.run(scenario, settings=settings).log


@pytest.mark.slow
def test_a_sweep_is_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    make_runs_here(monkeypatch)
    done = offtrack.sweep("cambered-road", {"surface.cross_fall": [0.0, 0.02]}, settings=SHORT, jobs=1)
    table = done.to_pandas()
    assert table["surface.cross_fall"].tolist() == ["0.0", "0.02"]
    assert table["completed"].tolist() == [1, 1]
    assert table.attrs["units"]["off_tracking.true_rms_m"] == "m"
    again = offtrack.sweep(done.directory / "study.toml", out=done.directory, jobs=1)
    assert again.rows == done.rows


@pytest.mark.parametrize(
    ("use", "error", "says"),
    [
        (lambda: offtrack.run(5), TypeError, "scenario must be a name or a TOML file, not int"),  # type: ignore[arg-type]
        (lambda: offtrack.run("roundabout", seed=1.5), TypeError, "seed must be a whole number"),  # type: ignore[arg-type]
        (lambda: offtrack.run("roundabout", seed=-1), ValueError, "seed = -1 must not be negative"),
        (lambda: offtrack.run("roundabout", settings=["speed_kmh=3"]), TypeError, "settings must be a table"),  # type: ignore[arg-type]
        (lambda: offtrack.run("roundabout", speed_kmh=None), TypeError, "speed_kmh must be a text, a number"),
        (lambda: offtrack.load_run(3), TypeError, "directory must be a path, not int"),  # type: ignore[arg-type]
        (lambda: offtrack.load_run("nowhere"), ValueError, "nowhere: is no finished run: it has no summary.json"),
        (lambda: offtrack.sweep("roundabout", {"speed_kmh": "10"}), TypeError, "speed_kmh must be a list of values"),
    ],
)
def test_wrong_arguments_are_one_line(use: Callable[[], object], error: type[Exception], says: str) -> None:
    with pytest.raises(error, match=says) as caught:
        use()
    assert "\n" not in str(caught.value)


def test_a_folder_that_hides_a_package_is_named(tmp_path: Path) -> None:
    """A notebook's own folder comes first in the path."""
    (tmp_path / "controllers").mkdir()
    (tmp_path / "controllers" / "__init__.py").touch()
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-c", "import offtrack"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    hiding = tmp_path / "controllers" / "__init__.py"
    assert f"ImportError: {hiding} hides offtrack's package controllers" in done.stderr.splitlines()[-1]


def test_a_signal_has_its_unit_and_a_wrong_name_the_right_one(run: offtrack.Run) -> None:
    """What is computed of the values is in another unit."""
    values = run["off_tracking_true"]
    assert (values.unit, getattr(values**2, "unit", "")) == ("m", "")
    assert values.description
    with pytest.raises(KeyError, match="did you mean 'off_tracking_true'"):
        _ = run["off_trackin_true"]


def test_a_run_is_plotted_with_a_panel_for_each_unit(run: offtrack.Run) -> None:
    figure = run.plot("off_tracking_true", "psi_tractor", "off_tracking_estimate")
    assert [axes.get_ylabel() for axes in figure.axes] == ["[m]", "[rad]"]
    assert [len(axes.lines) for axes in figure.axes] == [2, 1]
    assert len(run.plot().axes) == 1


def test_a_key_in_settings_and_in_keywords_is_refused() -> None:
    with pytest.raises(ValueError, match=r"surface\.friction is in settings and a keyword argument: choose one"):
        offtrack.run("roundabout", settings={"surface.friction": 0.3}, surface__friction=0.5)


def test_progress_is_shown_if_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    for shown in (True, False):
        offtrack.run("cambered-road", off_tracking="truth", course__length=20, progress=shown)
        assert ("cambered-road, seed 1" in capsys.readouterr().err) == shown
