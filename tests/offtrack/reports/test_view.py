"""Finished runs are laid over each other in one page, from their files alone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.reports.player.playback import Picture
from offtrack.reports.run_files import finished_run, pictures_of_page
from offtrack.reports.run_page import report_html
from scenarios.results.log import read_log
from scenarios.results.trailer_result import RunResult
from tests.browser import opened_page

LAWS = ("path_preview", "none")


def offtrack(*arguments: str) -> Any:
    return CliRunner().invoke(app, list(arguments))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two short runs of a truck that differ in the law, and one of a rover."""
    root = tmp_path_factory.mktemp("runs")
    keys = ("off_tracking=truth", "course.turn_deg=20", "speed_kmh=15", "course.exit=8", "course.entry=24")
    base = [*(word for key in keys for word in ("--set", key)), "--no-video", "--quiet"]
    for law in LAWS:
        done = offtrack("run", "turn-90", "--set", f"trailer_steering={law}", *base, "--out", str(root / law))
        assert done.exit_code == 0, done.output
    done = offtrack("run", "rover-slope", "--set", "slip_estimator=truth", "--set", "course.length=1",
                    "--no-video", "--quiet", "--out", str(root / "rover"))  # fmt: skip
    assert done.exit_code == 0, done.output
    return [root / name for name in (*LAWS, "rover")]


@pytest.mark.slow
def test_two_runs_play_together_and_their_numbers_stand_side_by_side(
    browser: Any, runs: list[Path], tmp_path: Path
) -> None:
    page = tmp_path / "both.html"
    done = offtrack("view", *map(str, runs[:2]), "--out", str(page))
    assert done.exit_code == 0, done.output
    logs = [read_log(run / "signals.parquet") for run in runs[:2]]
    with opened_page(browser, page) as opened:
        opened.value("player.show(8)")
        rows = [int(np.searchsorted(log["time"], 8.0001)) - 1 for log in logs]
        assert opened.value("player.rows") == rows
        opened.page.check('[data-part="stations-on"]')
        opened.value("player.show(30)")
        driven = opened.value("player.playback.runs.map((run, k) => run.stations[player.rows[k]])")
        assert driven == pytest.approx([30.0, 30.0], abs=0.05)
        assert opened.messages == []
        table = opened.page.inner_text("text=Off-tracking >> nth=0 >> xpath=/ancestor::main")
        assert all(run.name in table for run in runs[:2])


@pytest.mark.slow
def test_a_run_alone_is_rebuilt_as_it_was_and_a_rover_is_viewed_too(runs: list[Path], tmp_path: Path) -> None:
    run = finished_run(runs[0], "one")
    assert isinstance(run.result, RunResult)
    assert run.result.outcome == "completed"
    assert [trailer.n_steered for trailer in run.result.trailers] == [2]
    assert run.result.trailers[0].follow_distance == pytest.approx(14.0)
    assert offtrack("view", str(runs[2]), "--out", str(tmp_path / "rover.html")).exit_code == 0


@pytest.mark.slow
def test_pictures_come_back_from_a_page(camera_run: RunResult, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text(report_html(camera_run, camera_run.summary()), encoding="utf-8")
    pictures = pictures_of_page(page)
    assert len(pictures) == len(camera_run.frames)
    assert pictures[7].time == pytest.approx(1e-3 * camera_run.frames[7].tick)
    assert isinstance(pictures[7], Picture)
    assert 100 < len(pictures[7].strokes) <= 160
    page.write_text(page.read_text(encoding="utf-8").replace("playback-numbers", "playback-others"), encoding="utf-8")
    assert pictures_of_page(page) == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("which", "line"),
    [
        ((0, 2), "runs of trailers and of rovers can't be laid over each other"),
        ((0, 0), "a run is named twice"),
    ],
)
def test_runs_that_do_not_go_together_are_refused(runs: list[Path], tmp_path: Path, which: Any, line: str) -> None:
    done = offtrack("view", *(str(runs[k]) for k in which), "--out", str(tmp_path / "page.html"))
    assert (done.exit_code, done.output.count("\n")) == (2, 1)
    assert line in done.output
    assert not (tmp_path / "page.html").exists()
