"""Pages that play runs, recordings, assessments and studies show at every time what the log holds."""

import base64
import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.reports.player.encoding import encoded, kept_rows, small_pictures
from offtrack.reports.player.playback import Picture, fault_spans, health_spans, trailer_playback
from offtrack.reports.run_page import report_html
from scenarios.results.log import Log, Signal, read_log, write_log
from scenarios.results.swept_path import placed
from scenarios.results.trailer_result import RunResult
from tests.browser import Opened, opened_page

MOMENT = 12.345  # [s]


@pytest.fixture(scope="module")
def written(camera_run: RunResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    (folder / "report.html").write_text(report_html(camera_run, camera_run.summary()), encoding="utf-8")
    write_log(camera_run.log, folder / "signals.parquet")
    return folder


@pytest.fixture(scope="module")
def log(written: Path) -> Log:
    return read_log(written / "signals.parquet")


@pytest.fixture(scope="module")
def opened(browser: Any, written: Path) -> Iterator[Opened]:
    with opened_page(browser, written / "report.html") as page:
        yield page


def row_at(log: Log, t: float) -> int:
    return int(np.searchsorted(log["time"], t + 1e-4, side="right")) - 1


def check_all_parts(opened: Opened, log: Log, t: float, run: RunResult) -> None:
    row = row_at(log, t)
    assert opened.value("player.t") == pytest.approx(t, abs=1e-6)
    assert opened.page.inner_text('[data-part="now"]') == f"{t:.2f} s"
    speed = opened.page.inner_text('dd[data-signal="v_x_tractor"]')
    assert speed == f"{3.6 * log['v_x_tractor'][row]:.1f} km/h"
    true = opened.page.inner_text('dd[data-signal="off_tracking_true"]')
    assert true == f"{np.float32(log['off_tracking_true'][row]):.3f} m"
    assert opened.value("player.charts.heads") == pytest.approx(
        [t] * len(opened.value("player.charts.heads")), abs=0.02
    )
    drawn = np.array(opened.value("player.plan.outlines[0]"))
    for k, unit in enumerate(run.units):
        pose = np.array([[log[f"{quantity}_{unit.name}"][row] for quantity in ("x", "y", "psi")]])
        assert drawn[k] == pytest.approx(placed(unit.corners, pose)[0], abs=1e-4)
    times = np.array([1e-3 * frame.tick for frame in run.frames])
    number = max(0, int(np.searchsorted(times, t + 1e-4, side="right")) - 1)
    assert opened.value("player.picture") == number
    assert f"picture {number + 1} of {len(times)}" in opened.page.inner_text('[data-part="caption"]')


@pytest.mark.slow
@pytest.mark.parametrize("way", ["slider", "keys", "link", "chart"])
def test_each_way_of_choosing_the_time_shows_what_the_log_holds(
    opened: Opened, log: Log, camera_run: RunResult, way: str
) -> None:
    page = opened.page
    page.evaluate("player.show(3)")
    if way == "slider":
        page.evaluate(
            f"(() => {{ const s = document.querySelector('[data-part=time]'); s.value = {MOMENT};"
            "s.dispatchEvent(new Event('input')); })()"
        )
        t = MOMENT
    elif way == "keys":
        page.focus('[data-part="plan"]')
        for key in ("ArrowRight", "Shift+ArrowRight", "ArrowLeft"):
            page.keyboard.press(key)
        t = 3.0 + 10 * float(opened.value("player.step"))
    elif way == "link":
        page.evaluate(f"location.hash = '#t={MOMENT:.2f}'")
        page.wait_for_function(f"Math.abs(player.t - {MOMENT:.2f}) < 1e-6")
        t = round(MOMENT, 2)
    else:
        box = page.locator(".u-over").first.bounding_box()
        page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 20)
        page.mouse.move(2, 2)
        page.wait_for_timeout(50)
        t = float(opened.value("player.t"))
        middle = opened.value("((plot) => plot.posToVal(plot.over.clientWidth / 2, 'x'))(player.charts.plots[0])")
        assert t == pytest.approx(middle, abs=0.2)
        page.evaluate(f"player.show({t:.2f})")
        t = round(t, 2)
    check_all_parts(opened, log, t, camera_run)


def test_hovering_a_chart_reads_its_values_with_units(opened: Opened, log: Log) -> None:
    page = opened.page
    page.evaluate("player.show(3)")
    box = page.locator(".u-over").first.bounding_box()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 30)
    page.wait_for_timeout(50)
    index = opened.value("player.charts.plots[0].cursor.idx")
    text = page.inner_text(".chart >> nth=0")
    assert f"{np.float32(log['off_tracking_true'][index]):.3f} m" in text
    page.mouse.move(2, 2)


def test_play_moves_on_and_stops_at_the_end(opened: Opened) -> None:
    page = opened.page
    page.evaluate("player.show(player.end - 0.4)")
    page.keyboard.press("Space")
    page.wait_for_function("!player.playing", timeout=8000)
    assert opened.value("player.t") == opened.value("player.end")


@pytest.mark.slow
def test_the_3d_view_draws_the_vehicle(opened: Opened) -> None:
    page = opened.page
    page.evaluate("player.show(5)")
    page.click('[data-view="scene"]')
    shots = []
    for t in (5, 15):
        page.evaluate(f"player.show({t})")
        image = cv2.imdecode(
            np.frombuffer(page.locator('[data-part="scene"]').screenshot(), np.uint8), cv2.IMREAD_COLOR
        )
        assert image is not None
        shots.append(image)
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 50
    assert np.any(shots[0] != shots[1])
    page.click('[data-view="plan"]')


@pytest.mark.slow
def test_page_asks_nothing_of_a_network_is_quick_and_fits_a_phone(browser: Any, written: Path) -> None:
    page = written / "report.html"
    with opened_page(browser, page, width=390, height=844, link="#t=8.00") as opened:
        assert opened.value("document.documentElement.scrollWidth") <= 390
        assert opened.value("player.t") == 8.0
        assert opened.value("player.plan.size().width") > 250
        opened.value("player.show(10)")
        opened.page.wait_for_timeout(100)
        asked = [url.partition("#")[0] for url in opened.requests if not url.startswith(("data:", "blob:"))]
        assert asked == [page.resolve().as_uri()]
        assert opened.messages == []
        assert float(opened.value("document.getElementById('player').dataset.ready")) < 3000.0  # 300 when quiet


def numbers_of(table: dict[str, Any], text: str, signal: str) -> np.ndarray[Any, Any]:
    place = next(one for one in table["runs"][0]["signals"] if one["name"] == signal)["values"]
    data = gzip.decompress(base64.b64decode(text))
    return np.frombuffer(data, "<f4", place["count"], place["at"])


def test_numbers_are_those_of_the_log(camera_run: RunResult) -> None:
    page = encoded(trailer_playback(camera_run))
    table = json.loads(page.table)
    for name in ("time", "x_trailer", "off_tracking_estimate"):
        np.testing.assert_array_equal(
            numbers_of(table, page.numbers, name), camera_run.log[name].astype(np.float32), err_msg=name
        )


def test_all_estimates_stay_when_rows_are_left_out() -> None:
    rows = np.column_stack([np.arange(1000.0), np.where(np.arange(1000) % 7 == 3, 1.0, np.nan)])
    log = Log((Signal("time", "s", "time"), Signal("estimate", "m", "sparse")), rows)
    kept = kept_rows(log, 200)
    assert len(kept) < 300
    assert set(np.flatnonzero(np.isfinite(rows[:, 1]))) <= set(kept.tolist())
    assert kept[-1] == 999


@pytest.mark.parametrize("room", [40_000, 60_000, 10_000_000])
def test_pictures_fit_into_their_room_and_the_page_says_so(camera_run: RunResult, room: int) -> None:
    pictures = [Picture(1e-3 * frame.tick, frame.jpeg, frame.tracks) for frame in camera_run.frames[:40]]
    small, note = small_pictures(pictures, room)
    assert sum(len(one.jpeg) for one in small) <= room
    assert ("of them is shown" in note) == (len(small) < 40)
    image = cv2.imdecode(np.frombuffer(small[0].jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    assert small[0].scale == pytest.approx(image.shape[1] / 1344)


def test_a_picture_that_can_not_be_decoded_is_left_out(camera_run: RunResult) -> None:
    broken = Picture(0.0, b"no jpeg", np.empty((0, 4), np.float32))
    whole = Picture(1.0, camera_run.frames[0].jpeg, np.empty((0, 4), np.float32))
    assert [one.picture.time for one in small_pictures([broken, whole], 10**6)[0]] == [1.0]


def test_spans_of_health_and_faults() -> None:
    health = np.array([np.nan, 0.0, np.nan, 1.0, 1.0, 2.0, 0.0])
    log = Log((Signal("time", "s", "time"), Signal("health", "-", "health")), np.column_stack([np.arange(7.0), health]))
    assert [(s.label, s.start, s.end) for s in health_spans(log, "health")] == [
        ("no estimate yet", 0.0, 1.0),
        ("estimate degraded", 3.0, 5.0),
        ("estimate lost", 5.0, 6.0),
    ]
    toml = 'faults = [{kind = "freeze", start = 2.0, duration = 1.5}, {kind = "dirt"}]'
    assert [(s.label, s.start, s.end) for s in fault_spans(toml, log)] == [
        ("fault freeze", 2.0, 3.5),
        ("fault dirt", 0.0, 6.0),
    ]


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
        names = [f"{law} · speed {speed} km/h" for speed in (14, 15) for law in ("none", "path_preview")]
        assert opened.value("player.playback.runs.map((run) => run.name)") == names
        assert opened.value("document.querySelectorAll('#explorer polyline').length") == 4
        assert opened.value("explorer.axes.map((axis) => axis.label).slice(0, 2)") == [
            "trailer steering",
            "speed [km/h]",
        ]
        assert opened.messages == []
        opened.page.locator("#explorer circle").nth(2).click()
        opened.page.wait_for_url("**/pages/*.html*", timeout=8000)
        opened.page.wait_for_selector("#player[data-ready]", state="attached")
        name = opened.page.inner_text("h1")
        assert "speed_kmh=" in name
        assert "trailer_steering=" in name
