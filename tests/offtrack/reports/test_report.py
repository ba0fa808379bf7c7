"""The report is one page that needs nothing else, and says only what the run can tell."""

import dataclasses
import math
import re

import numpy as np
import pytest

from offtrack.reports.player.playback import trailer_playback
from offtrack.reports.run_page import report_html
from offtrack.reports.sections import changes, course_title, groups, where
from scenarios.options.scenario import load_scenario
from scenarios.results.log import Log
from scenarios.results.run_summary import number_at
from scenarios.results.swept_path import RoadEdges
from scenarios.results.trailer_result import RunResult


@pytest.fixture(scope="module")
def page(camera_run: RunResult) -> str:
    return report_html(camera_run, camera_run.summary())


@pytest.mark.slow
def test_the_page_needs_nothing_else_and_shows_what_there_is(page: str, camera_run: RunResult) -> None:
    """It is mailed around and opened behind firewalls; xmlns and ids of SVG are names, not links.

    A comment with angle brackets in the scenario is quoted. The summary is in metres, the error is in millimetres. The
    simulation's speed stands at the foot. The same run gives the same page: no dates, no random identifiers.
    """
    assert set(re.findall(r'(?:src|href)="([^"]{5})', page)) <= {"data:", "#m", *re.findall(r'href="(#[^"]{4})', page)}
    assert "@import" not in page
    assert not re.findall(r"url\((?!#)", page)
    assert re.findall(r"<h2>(.*?)</h2>", page) == ["Playback", "All numbers", "Computing time"]
    assert "# &lt;dry&gt;" in page
    numbers = camera_run.summary()["off_tracking"]
    assert isinstance(numbers, dict)
    error = numbers["estimate_error_rms_m"]
    assert isinstance(error, float)
    assert f"{1e3 * error:.1f} mm" in page
    assert re.findall(r'<div class="card">.*?<span>(.*?)</span>', page) == [
        *("True off-tracking, maximum", "Wheel clearance, left", "Swept width", "Estimate error, RMS")
    ]
    assert "0.62 times real time" in page[page.index("Computing time") :]
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
    unlabelled = {path for path in unlabelled if not re.search(r"_(time_s|[xy]_m)$", path)}  # stand beside their number
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


def test_the_demanded_steer_angles_are_drawn(blind_run: RunResult) -> None:
    """A dashed curve beside each of the three axles' angles, and the limit of the actuators."""
    (chart,) = (one for one in trailer_playback(blind_run).charts if one.title.startswith("Steer"))
    dashed = [curve.signal for curve in chart.curves if curve.style == "dashed"]
    assert dashed == list(blind_run.steer_signals(demands=True))
    assert chart.limit == pytest.approx(math.degrees(blind_run.trailer_steer_limit or math.nan))


def test_numbers_have_their_time_and_place(blind_run: RunResult) -> None:
    """They are where the signals say: the largest off-tracking, and the wheel that is nearest to an edge."""
    summary, time = blind_run.summary(), blind_run.log["time"]
    true = np.abs(blind_run.signal("off_tracking_true"))
    assert number_at(summary, "off_tracking.true_max_time_s") == pytest.approx(time[np.nanargmax(true)])
    assert where(summary, "off_tracking.true_max_m").startswith("after ")
    edges = RoadEdges(blind_run.road, blind_run.road_half_width)
    for side in ("left", "right"):
        least, x, y = (number_at(summary, f"road.wheel_clearance_{side}_{name}") for name in ("m", "x_m", "y_m"))
        inside, on_left = edges.distance(np.array([[x, y]], dtype=float))
        assert inside[0] == pytest.approx(least, abs=1e-4)  # the place is rounded to micrometres
        assert on_left[0] == (side == "left")


@pytest.mark.slow
def test_a_page_says_what_there_is_not(blind_run: RunResult, camera_run: RunResult) -> None:
    """Without cameras no chart of features; warnings come first; a page of an odometry that never worked."""
    doubtful = dataclasses.replace(blind_run, warnings=("units.0 (tractor): <light>",))
    pages = [report_html(run, run.summary()) for run in (blind_run, doubtful)]
    titles = [re.findall(r"<h2>(.*?)</h2>", page) for page in pages]
    assert "Features per frame" not in pages[0]
    assert "Visual odometry" not in pages[0]
    assert (titles[1][0], "Warnings" in pages[0]) == ("Warnings", False)
    assert "units.0 (tractor): &lt;light&gt;" in pages[1]
    rows = camera_run.log.rows.copy()
    health = camera_run.log.names.index("health")
    rows[np.isfinite(rows[:, health]), health] = 2.0
    lost = dataclasses.replace(camera_run, log=Log(camera_run.log.signals, rows))
    spans = trailer_playback(lost).runs[0].spans
    assert [span.label for span in spans] == ["estimate lost"]
    assert "estimate lost" in report_html(lost, lost.summary())


def test_changed_faults_are_written_as_they_are_set() -> None:
    """A heading is read by people, and copied into the next command; an own kind need not be at hand any more."""
    faults = "decalibration:-0.15,0.1,0@10; freeze@20+1"
    scenario = load_scenario("roundabout", (f"faults={faults}",)).model_dump(mode="json", exclude_none=True)
    assert changes(scenario) == f"Changed: faults = {faults}"
    assert "faults = my:Kind:1.5@3" in changes(
        scenario | {"faults": [{"kind": "my:Kind", "amount": [1.5], "start": 3.0}]}
    )


@pytest.mark.parametrize(
    ("settings", "changed", "title"),
    [
        (("course.turn_deg=60",), "course.turn_deg = 60.0", "roundabout"),
        (("course.kind=figure-of-eight",), "course.kind = figure-of-eight", "figure-of-eight (scenario roundabout)"),
        (("course.kind=straight",), "course.kind = straight", "straight (scenario roundabout)"),
        (("traffic=mixed", "off_tracking=truth"), "off_tracking = truth, traffic.kind = mixed", "roundabout"),
        ((), "", "roundabout"),
    ],
)
def test_only_what_was_changed_is_listed_and_a_title_names_the_course(
    settings: tuple[str, ...], changed: str, title: str
) -> None:
    """Another kind of course brings its own defaults, which nobody has set."""
    scenario = load_scenario("roundabout", settings).model_dump(mode="json", exclude_none=True)
    assert changes(scenario).removeprefix("Changed: ") == changed
    assert course_title(scenario) == title
