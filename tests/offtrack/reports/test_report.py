"""The report is one page that needs nothing else, and says only what the run can tell."""

import dataclasses
import math
import re

import numpy as np
import pytest

from offtrack.reports.player.playback import trailer_playback
from offtrack.reports.plots import chart_figure
from offtrack.reports.run_page import report_html
from offtrack.reports.sections import changes, groups
from scenarios.options.scenario import load_scenario
from scenarios.results.log import Log
from scenarios.results.trailer_result import RunResult


@pytest.fixture(scope="module")
def page(camera_run: RunResult) -> str:
    return report_html(camera_run, camera_run.summary())


@pytest.mark.slow
def test_the_page_needs_nothing_else_and_shows_what_there_is(page: str, camera_run: RunResult) -> None:
    """It is mailed around and opened behind firewalls; xmlns and ids of SVG are names, not links.

    Figures share one page: a repeated id would make one use another's clip path. A comment with angle brackets in the
    scenario is quoted. The summary is in metres, the error is shown in millimetres. The camera image is that with the
    largest off-tracking, with all its features. The same run gives the same page: no dates, no random identifiers.
    """
    assert set(re.findall(r'(?:src|href)="([^"]{5})', page)) <= {"data:", "#m", *re.findall(r'href="(#[^"]{4})', page)}
    assert "@import" not in page
    assert not re.findall(r"url\((?!#)", page)
    identifiers = re.findall(r'<(?:clipPath|path|defs)[^>]* id="([^"]+)"', page)
    assert len(set(identifiers)) == len(identifiers)
    assert re.findall(r"<h2>(.*?)</h2>", page) == [
        *("Playback", "Plan view", "Off-tracking", "Error of the estimate", "Steer angles of the road wheels"),
        *("Features per frame", "Camera image", "All numbers", "Computing time"),
    ]
    assert "# &lt;dry&gt;" in page
    numbers = camera_run.summary()["off_tracking"]
    assert isinstance(numbers, dict)
    error = numbers["estimate_error_rms_m"]
    assert isinstance(error, float)
    assert f"{1e3 * error:.1f} mm" in page
    assert "0.62 <small>× real time" in page
    assert page.count('r="1.6"') in {len(frame.tracks) for frame in camera_run.frames}
    assert report_html(camera_run, camera_run.summary()) == page


def test_every_number_of_a_summary_has_a_label(camera_run: RunResult) -> None:
    """All that a run measures, but for its computing times and for what only recorded reference units have."""
    unlabelled = {
        f"{group}.{name}"
        for group, numbers in camera_run.summary().items()
        if isinstance(numbers, dict)
        for name in numbers
        if name not in groups()[group].numbers
    }
    times = {"simulated_s", "wall_s", "physics_s", "render_s", "odometry_s"}
    reference = {"reference_error_rms_m", "estimate_against_reference_rms_m"}
    assert unlabelled == {f"timing.{name}" for name in times} | {f"off_tracking.{name}" for name in reference}


def test_a_label_has_the_unit_of_its_number() -> None:
    """Factors turn metres into millimetres, radians into degrees and shares into percent; an ending _m is a length."""
    factors = {"m": 1.0, "mm": 1e3, "%": 100.0, "°": 1.0, "°/s": 1.0, "g": 1.0, "m/s²": 1.0, "km/h": 3.6}
    for group in groups().values():
        for name, number in group.numbers.items():
            if name.endswith("_rad"):
                assert (number.unit, number.factor) == ("°", math.degrees(1.0))
            elif number.unit == "%" and name.endswith("_percent"):
                assert number.factor == 1.0
            else:
                assert number.factor == factors.get(number.unit, 1.0), name
            if name.endswith("_m"):
                assert number.unit in ("m", "mm", "°/m"), name


def steer_figure(run: RunResult) -> str:
    playback = trailer_playback(run)
    return next(
        chart_figure(chart, playback.runs[0]).svg for chart in playback.charts if chart.title.startswith("Steer")
    )


def test_the_commanded_steer_angles_are_drawn(blind_run: RunResult) -> None:
    """A curve for each of the three axles: without demands in the log the figure has far fewer points."""
    rows = blind_run.log.rows.copy()
    for name in blind_run.steer_signals(demands=True):
        rows[:, blind_run.log.names.index(name)] = np.nan
    undemanded = dataclasses.replace(blind_run, log=Log(blind_run.log.signals, rows))
    drawn, missing = (steer_figure(run).count("\nL ") for run in (blind_run, undemanded))
    assert drawn > missing + 90  # 30 points a curve: matplotlib leaves out those on straight lines


@pytest.mark.slow
def test_a_page_says_what_there_is_not(blind_run: RunResult, camera_run: RunResult) -> None:
    """No empty diagrams without cameras; warnings come first; a page of an odometry that never worked."""
    doubtful = dataclasses.replace(blind_run, warnings=("units.0 (tractor): <light>",))
    pages = [report_html(run, run.summary()) for run in (blind_run, doubtful)]
    titles = [re.findall(r"<h2>(.*?)</h2>", page) for page in pages]
    assert {"No estimate", "No camera images"} <= set(titles[0])
    assert "Features per frame" not in titles[0]
    assert "Visual odometry" not in pages[0]
    assert (titles[1][0], "Warnings" in pages[0]) == ("Warnings", False)
    assert "units.0 (tractor): &lt;light&gt;" in pages[1]
    rows = camera_run.log.rows.copy()
    health = camera_run.log.names.index("health")
    rows[np.isfinite(rows[:, health]), health] = 2.0
    lost = dataclasses.replace(camera_run, log=Log(camera_run.log.signals, rows))
    assert ">estimate lost<" in report_html(lost, lost.summary())


def test_changed_faults_are_written_as_they_are_set() -> None:
    """A heading is read by people, and copied into the next command; an own kind need not be at hand any more."""
    faults = "decalibration:-0.15,0.1,0@10; freeze@20+1"
    scenario = load_scenario("roundabout", (f"faults={faults}",)).model_dump(mode="json", exclude_none=True)
    assert changes(scenario) == f"Changed: faults = {faults}"
    assert "faults = my:Kind:1.5@3" in changes(
        scenario | {"faults": [{"kind": "my:Kind", "amount": [1.5], "start": 3.0}]}
    )
