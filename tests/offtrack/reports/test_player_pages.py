"""Recordings, assessments and rovers play in the same page as trailers' runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.results.log import read_log
from tests.browser import opened_page


def offtrack(*arguments: str) -> None:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == 0, done.output


@pytest.fixture(scope="module")
def assessed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("assessed") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "offtrack.studies.standards.assessment.default_jobs", lambda: 1
        )  # a worker takes seconds to start
        offtrack("assess", "eu_tractor_semitrailer", "--manoeuvres", "turn,lane_change", "--out", str(out), "--quiet")
    return out


@pytest.mark.slow
@pytest.mark.parametrize("width", [1400, 390])
def test_an_assessment_plays_one_manoeuvre_at_a_time(browser: Any, assessed: Path, width: int) -> None:
    with opened_page(browser, assessed / "report.html", width=width) as opened:
        names = opened.value("player.playback.all.map((run) => run.name)")
        assert len(names) == 2
        for k, key in enumerate(("turn", "lane_change")):
            log = read_log(assessed / f"{key}.parquet")
            opened.page.select_option('[data-part="run"]', str(k))
            assert opened.value("player.playback.runs.length") == 1
            assert opened.value("player.end") == pytest.approx(log["time"][-1], abs=0.02)
            opened.value("player.show(3.0)")
            t, x = opened.value("[player.playback.runs[0].time[player.rows[0]],"
                                "player.playback.runs[0].pose(0, player.rows[0])[0]]")  # fmt: skip
            assert x == pytest.approx(np.interp(t, log["time"], log["x_tractor"]), abs=1e-3)
        assert opened.messages == []
        assert opened.value("document.documentElement.scrollWidth") <= width


@pytest.mark.slow
def test_a_rover_and_its_recording_play_with_their_images(browser: Any, tmp_path: Path) -> None:
    short = ["--set", "course.length=0.6"]
    offtrack("run", "rover-slope", *short, "--no-video", "--quiet", "--out", str(tmp_path / "run"),
             "--record", str(tmp_path / "images"))  # fmt: skip
    offtrack("estimate", "slip", str(tmp_path / "images"), "--out", str(tmp_path / "slip"), "--quiet")
    for folder in ("run", "slip"):
        with opened_page(browser, tmp_path / folder / "report.html") as opened:
            opened.value("player.show(player.end)")
            opened.page.wait_for_function("player.pictures.drawn === player.pictures.wanted")
            last = int(opened.value("player.playback.runs[0].pictures.length"))
            assert opened.value("player.picture") == last - 1
            assert last > 20
            assert opened.messages == []


@pytest.mark.slow
@pytest.mark.usefixtures("runs_here")
def test_a_study_leads_to_the_pages_of_its_runs(browser: Any, tmp_path: Path) -> None:
    """A click on a line of the drawing opens the page that plays the run; the first seed's runs play together."""
    out = tmp_path / "study"
    short = ["--set", "course.turn_deg=10", "--set", "course.exit=5", "--set", "course.entry=20"]
    offtrack("compare", "turn-90", "--controllers", "none,path_preview", "--vary", "speed_kmh=14,15", *short,
             "--out", str(out), "--quiet")  # fmt: skip
    with opened_page(browser, out / "report.html") as opened:
        assert opened.value("player.playback.runs.map((run) => run.name)") == ["none", "path_preview"]
        assert opened.value("document.querySelectorAll('#explorer polyline').length") == 4
        assert opened.value("explorer.axes.map((axis) => axis.label).slice(0, 2)") == ["trailer_steering", "speed_kmh"]
        assert opened.messages == []
        opened.page.locator("#explorer circle").nth(2).click()
        opened.page.wait_for_url("**/pages/*.html*", timeout=8000)
        opened.page.wait_for_selector("#player[data-ready]", state="attached")
        name = opened.page.inner_text("h1")
        assert "speed_kmh=" in name
        assert "trailer_steering=" in name
