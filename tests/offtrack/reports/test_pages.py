"""Pages of runs; finished runs are laid over each other in one page, from their files alone."""

import json
import os
import re
import shutil
import time
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.reports.page import (
    Card,
    Cell,
    Column,
    Content,
    Items,
    Page,
    Preformatted,
    Section,
    Table,
    Verdict,
)
from offtrack.reports.player.encoding import explorer_script, player_script
from offtrack.reports.player.playback import Picture
from offtrack.reports.plots import drawn
from offtrack.reports.run_files import finished_run, pictures_of_page
from offtrack.reports.run_page import report_html
from scenarios.results.log import Log, read_log, write_log
from scenarios.results.trailer_result import RunResult
from tests.browser import opened_page

BAD: Final = "<script>alert('$x^')</script>"  # a tag, quotes, and mathematics that matplotlib can not parse


TEMPLATES: Final = Path(__file__).resolve().parents[3] / "offtrack" / "reports" / "templates"


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height"), [(1400, 900), (390, 800)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_run_page_opens_with_its_answer_at_the_largest_off_tracking(
    browser: Any, camera_run: RunResult, tmp_path: Path, width: int, height: int, scheme: Any
) -> None:
    """Verdict and all four tiles stand within the first screen; nothing is wider than it."""
    page = tmp_path / "report.html"
    page.write_text(report_html(camera_run, camera_run.summary()), encoding="utf-8")
    worst = camera_run.log["time"][np.nanargmax(np.abs(camera_run.signal("off_tracking_true")))]
    with opened_page(browser, page, width=width, height=height, scheme=scheme) as opened:
        assert opened.value("player.t") == pytest.approx(worst, abs=1e-4)
        bottoms = (
            "[...document.querySelectorAll('.outcome, .answer, .card')].map((e) => e.getBoundingClientRect().bottom)"
        )
        found = opened.value(bottoms)
        assert len(found) == 5  # the verdict and four tiles
        assert max(found) < height
        assert opened.value("document.documentElement.scrollWidth") <= width
        opened.value("player.show(0)")
        estimated = opened.page.inner_text('dd[data-signal="off_tracking_estimate"]')
        assert estimated == "no estimate yet"
        assert "no estimate yet" in opened.page.inner_text('[data-part="spans"]')
        assert opened.messages == []


@pytest.mark.parametrize(
    "content",
    [
        Table((Column("name", BAD), Column("number", BAD)), [[BAD], [BAD, Cell(BAD, colour=BAD, share=0.5)]]),
        Items([BAD]),
        Items([BAD], numbered=True),
        Preformatted(BAD),
    ],
    ids=lambda content: content.kind,
)
def test_every_kind_of_content_is_escaped(content: Content) -> None:
    html = Page(
        title=BAD, heading=BAD, subtitle=BAD, verdict=Verdict(BAD, True), answer=[BAD],
        cards=[Card(BAD, BAD, BAD, BAD)],
        sections=[Section(BAD, BAD, [content], Verdict(BAD, False)), Section(BAD, content=[content], collapsed=True)],
    ).html()  # fmt: skip
    html = without_own_scripts(html)
    assert "<script" not in html
    assert "'$x^'" not in html
    assert escape(BAD, quote=False).replace("'", "&#39;") in html


def test_a_figure_keeps_its_lettering_as_text() -> None:
    """Labels are escaped by matplotlib, and their dollars are not read as mathematics."""
    with drawn("hostile") as (drawing, ax):
        ax.plot([0.0, 1.0], [0.0, 1.0], label=BAD)
        ax.set(xlabel=BAD, ylabel=BAD)
    assert "<script" not in drawing.content.svg
    assert drawing.content.svg.count(escape(BAD, quote=False)) == 2 * 3  # for wide pages and for phones


def without_own_scripts(html: str) -> str:
    """A page without the script of the playback and its blocks of base64."""
    for script in (player_script(), explorer_script()):
        html = html.replace(f"<script>\n{script}\n</script>", "")
    return re.sub(r'<script type="text/plain" id="playback-\w+">[A-Za-z0-9+/=\n]*</script>', "", html)


def test_markup_is_marked_as_safe_in_one_place() -> None:
    """The SVG of a figure and the playback's own files, and nothing else, go into a page as they are."""
    templates = "".join(path.read_text(encoding="utf-8") for path in TEMPLATES.glob("*.j2"))
    safe = re.findall(r"\{\{ ([\w.]+) \| safe \}\}", templates)
    assert sorted(safe) == ["explorer.script", "figure.svg", "page.player_style", "player.script"]
    assert templates.count("safe") == 4
    assert "autoescape" not in templates


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
    [((0, 2), "runs of trailers and of rovers can't be laid over each other"), ((0, 0), "a run is named twice")],
)
def test_runs_that_do_not_go_together_are_refused(runs: list[Path], tmp_path: Path, which: Any, line: str) -> None:
    done = offtrack("view", *(str(runs[k]) for k in which), "--out", str(tmp_path / "page.html"))
    assert (done.exit_code, done.output.count("\n")) == (2, 1)
    assert line in done.output
    assert not (tmp_path / "page.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "content", ["<a " * 2_000_000, ' id="playback-table">' * 300_000, None], ids=["markup", "ids", "pipe"]
)
def test_a_page_without_pictures_costs_no_time(content: str | None, tmp_path: Path) -> None:
    """Seven megabytes of markup, and a pipe, that take a second of the processor at most."""
    page = tmp_path / "report.html"
    if content is None:
        os.mkfifo(page)
    else:
        page.write_text(content, encoding="utf-8")
    begin = time.process_time()
    assert pictures_of_page(page) == ()
    assert time.process_time() - begin < 1.0


SUMMARIES = {
    "[" * 100_000 + "]" * 100_000: "not JSON: tables and lists must be nested",
    "{}": "is no summary of a run",
    "[]": "must hold a JSON object",
    '{"outcome": "completed", "scenario": "a", "seed": null}': "needs outcome, scenario and seed",
    '{"outcome": "completed", "scenario": [], "seed": 1}': "needs outcome, scenario and seed",
    '{"outcome": "completed", "scenario": "a", "seed": NaN}': "not JSON: it has no NaN",
    '{"outcome": "completed", "scenario": "a", "seed": 1': "not JSON: ",
}


@pytest.mark.slow
@pytest.mark.parametrize("text", SUMMARIES)
def test_a_broken_summary_is_one_line(text: str, runs: list[Path], tmp_path: Path) -> None:
    broken = shutil.copytree(runs[0], tmp_path / "broken")
    (broken / "summary.json").write_text(text, encoding="utf-8")
    for command in ("view", "compare"):
        refused(SUMMARIES[text], command, str(runs[1]), str(broken), "--out", str(tmp_path / "out"))


@pytest.mark.slow
def test_numbers_of_other_kinds_in_a_summary_are_left_out(runs: list[Path], tmp_path: Path) -> None:
    odd = shutil.copytree(runs[0], tmp_path / "odd")
    summary = json.loads((odd / "summary.json").read_text(encoding="utf-8"))
    summary |= {"timing": {"wall_s": "long"}, "off_tracking": {"true_rms_m": [1], "true_max_m": {}}, "steer": 5}
    (odd / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    done = offtrack("view", str(runs[1]), str(odd), "--out", str(tmp_path / "page.html"))
    assert done.exit_code == 0, done.output


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 2], ids=["trailer", "rover"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300])
def test_poses_that_are_no_place_are_one_line(which: int, value: float, runs: list[Path], tmp_path: Path) -> None:
    odd = shutil.copytree(runs[which], tmp_path / "odd")
    log = read_log(odd / "signals.parquet")
    name = "x" if which else "x_tractor"
    rows = log.rows.copy()
    rows[3, log.names.index(name)] = value
    write_log(Log(log.signals, rows), odd / "signals.parquet")
    refused(f"signals.parquet: row 4: {name} = ", "view", str(odd), "--out", str(tmp_path / "out"))
    write_log(Log(log.signals, log.rows[::-1]), odd / "signals.parquet")
    for command in ("view", "export"):
        refused("signals.parquet: row 2: time = ", command, str(odd), "--out", str(tmp_path / "out"))


def refused(line: str, *arguments: str) -> None:
    done = offtrack(*arguments)
    assert (done.exit_code, done.output.count("\n")) == (2, 1), done.output
    assert line in done.output
