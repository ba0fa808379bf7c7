"""Every page escapes the text it is given: names, descriptions, outcomes, error texts, files."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Final, cast

import numpy as np
import pytest

from offtrack.exchange.recordings import recording_page, slip_estimation
from offtrack.exchange.recordings.estimation import Estimation
from offtrack.exchange.recordings.slip_estimation import _SIGNALS as SLIP_SIGNALS
from offtrack.exchange.recordings.slip_estimation import SlipEstimation
from offtrack.exchange.recordings.writers import RoverRecording
from offtrack.reports.page import (
    Bar,
    Card,
    Cell,
    Column,
    Content,
    Items,
    Page,
    Photo,
    Photos,
    Preformatted,
    Section,
    Stroke,
    Table,
    Verdict,
)
from offtrack.reports.player.encoding import explorer_script, player_script
from offtrack.reports.plots import drawn
from offtrack.reports.run_page import report_html, rover_report_html
from offtrack.studies.case import Case, Outcome
from offtrack.studies.standards.assessment import Assessment, AssessmentMatrix
from offtrack.studies.standards.assessment_report import assessment_page
from offtrack.studies.standards.proving_ground import Manoeuvre
from offtrack.studies.study import Study
from offtrack.studies.study_page import study_page
from offtrack.studies.table import rows_of
from offtrack.studies.tuning import Range, Trial, Tuning
from offtrack.studies.tuning_page import tuning_page
from offtrack.studies.validation.check import Check, Plot, Series
from offtrack.studies.validation.check import CheckSection as ValidationSection
from offtrack.studies.validation.suite import validation_page
from scenarios.results.log import Log, Signal
from scenarios.results.rover_result import RoverResult
from scenarios.results.summary_numbers import Timing
from scenarios.results.trailer_result import RunResult
from sensors.sand.trace_rig import TraceRig
from vehicle.combination.description import load_vehicle

BAD: Final = "<script>alert('$x^')</script>"  # a tag, quotes, and mathematics that matplotlib can not parse
VOID: Final = {"meta", "link", "br", "input", "img", "image", "path", "use", "circle", "rect"}


class Balance(HTMLParser):
    """Notes tags that are not closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Closed in itself."""

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID and (not self.open or self.open.pop() != tag):
            self.wrong.append(tag)


TEMPLATES: Final = Path(__file__).resolve().parents[3] / "offtrack" / "reports" / "templates"


def table_log(*columns: tuple[str, str], rows: int = 5) -> Log:
    """A log with these signals, all of them rising from 0 to 1."""
    values = np.linspace(0.0, 1.0, rows)[:, None] * np.ones(len(columns))
    return Log(tuple(Signal(name, unit, name) for name, unit in columns), values)


def run_html(run: RunResult) -> str:
    """The page of a run whose trailer, scenario, outcome and manifest have that name."""

    def renamed(name: str) -> str:
        return re.sub("trailer$", lambda _: BAD, name)

    signals = tuple(dataclasses.replace(signal, name=renamed(signal.name)) for signal in run.log.signals)
    units = tuple(
        dataclasses.replace(
            unit,
            name=renamed(unit.name),
            steer_signals=tuple(None if name is None else renamed(name) for name in unit.steer_signals),
        )
        for unit in run.units
    )
    bad = dataclasses.replace(
        run,
        scenario=BAD,
        scenario_toml=BAD,
        outcome=BAD,
        log=Log(signals, run.log.rows),
        units=units,
        trailers=tuple(dataclasses.replace(trailer, name=renamed(trailer.name)) for trailer in run.trailers),
        manifest={BAD: BAD},
    )
    return report_html(bad, bad.summary())


def rover_html(_: RunResult) -> str:
    rig = cast(TraceRig, SimpleNamespace(wheels=(SimpleNamespace(name=BAD, x=0.2, y=0.1),), watched=0,
                                         wheel_radius=0.1, wheel_width=0.1))  # fmt: skip
    names = ["tick", "time", "x", "y", "psi", "x_wheels", "y_wheels", "x_corrected", "y_corrected", "station", "health",
             "cross_track_true", "slip_angle_true", "slip_angle_estimate", "slip_angle_std", "slip_angle_lagged",
             "slip_angle_laser", f"slip_ratio_{BAD}", f"sinkage_{BAD}"]  # fmt: skip
    result = RoverResult(
        scenario=BAD,
        scenario_toml=BAD,
        seed=1,
        outcome=BAD,
        rover=BAD,
        log=table_log(*((name, "-") for name in names)),
        path=np.array([[0.0, 0.0], [1.0, 1.0]]),
        rig=rig,
        timing=Timing(simulated_s=1.0, wall_s=1.0, physics_s=0.5, render_s=0.5, odometry_s=0.0),
        frames=(),
        manifest={BAD: BAD},
    )
    return rover_report_html(result, result.summary())


def recording_html(_: RunResult) -> str:
    recording = SimpleNamespace(
        sequence=SimpleNamespace(directory=Path(BAD.replace("/", "|"))),
        calibration=SimpleNamespace(width=1, height=1, baseline=0.5),
        follow_distance=1.0,
        assumed=(BAD,),
    )
    estimation = cast(Estimation, SimpleNamespace(recording=recording, outcome=BAD, frames=()))
    numbers = {
        "frames": {"duration_s": 1.0}, "odometry": {"name": BAD}, "notes": [BAD], "warnings": [BAD],
        "dropped_frames": [{"frame": 3, "reason": BAD}],
    }  # fmt: skip
    return recording_page.report_page(estimation, table_log(("time", "s"), rows=1), numbers)


def slip_html(_: RunResult) -> str:
    log = table_log(*((signal.name, signal.unit) for signal in SLIP_SIGNALS))
    estimation = SlipEstimation(
        recording=cast(RoverRecording, SimpleNamespace(view=lambda k: BAD)),
        estimator=BAD, outcome=BAD, dropped={2: BAD}, log=log, seconds=1.0,
    )  # fmt: skip
    return slip_estimation.slip_page(estimation, {"recording": BAD, "frames": {"images": 5}})


def study_html(_: RunResult) -> str:
    study = Study(scenario=BAD, fixed=(), axes={"trailer_steering": (BAD,)}, seeds=(1,))
    case = Case(scenario=BAD, fixed=(), axes=(("trailer_steering", BAD), (BAD, "3")), seed=1)
    outcomes = [Outcome(case=case, numbers={"outcome": f"failed: {BAD}", "steer": {"max_deg": 1.0}})]
    return study_page(BAD, study, outcomes, rows_of(outcomes))


def tuning_html(_: RunResult) -> str:
    study = Study(scenario=BAD, fixed=(), axes={BAD: (BAD,)}, seeds=(1,))
    tuning = Tuning(
        law=BAD, ranges={BAD: Range(low=0.0, high=1.0)}, defaults={}, objectives=(BAD, "b"), tuned_on=study,
        judged_on=study, identity=BAD,
    )  # fmt: skip
    trials = [Trial(number=k, parameters={BAD: 0.5}, values=(1.0 + k, 2.0 - k)) for k in range(2)]
    return tuning_page(tuning, trials, trials[0], {BAD: (1.0, 2.0)})


def assessment_html(_: RunResult) -> str:
    vehicle = load_vehicle("eu_tractor_semitrailer")
    units = (vehicle.units[0], vehicle.units[1].model_copy(update={"name": BAD}))
    vehicle = vehicle.model_copy(update={"name": BAD, "summary": BAD, "units": units})
    log = table_log(("time", "s"), ("yaw_rate_tractor", "rad/s"), (f"yaw_rate_{BAD}", "rad/s"))
    pulse = Manoeuvre(key="pulse", title=BAD, how=BAD, outcome=BAD, figures={"yaw_damping": math.nan}, log=log)
    case = Assessment(vehicle=vehicle, trailer_steering=BAD, manoeuvres=(pulse,), linear={})
    return assessment_page(AssessmentMatrix(vehicle=vehicle, cases=(case,)))


def validation_html(_: RunResult) -> str:
    check = Check(name=BAD, value=1.0, target=1.0, tolerance=0.1, unit=BAD, source=BAD, remark=BAD)
    curve = Series(BAD, np.arange(3.0), np.arange(3.0), "model")
    plot = Plot(title=BAD, x_label=BAD, y_label=BAD, series=(curve,))
    return validation_page([ValidationSection(title=BAD, text=BAD, checks=(check,), plots=(plot,))], {BAD: BAD})


PAGES: Final = (run_html, rover_html, recording_html, slip_html, study_html, tuning_html, assessment_html,
                validation_html)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("made", PAGES, ids=lambda made: made.__name__.removesuffix("_html"))
def test_a_page_shows_hostile_names_as_text(made: Callable[[RunResult], str], camera_run: RunResult) -> None:
    """A name with a tag in it is shown with its brackets; it opens no element, in the page or in a figure."""
    html = without_own_scripts(made(camera_run))
    assert "<script" not in html
    assert "&lt;script&gt;alert(" in html
    balance = Balance()
    balance.feed(html)
    assert (balance.wrong, balance.open) == ([], [])


def test_a_run_page_shows_the_image_where_the_off_tracking_was_largest(camera_run: RunResult) -> None:
    """The caption states the time of the image; they were taken at 10 Hz."""
    worst = camera_run.log["time"][np.nanargmax(np.abs(camera_run.signal("off_tracking_true")))]
    shown = re.search(
        r"Left camera at ([\d.]+) s, where the off-tracking was largest", report_html(camera_run, camera_run.summary())
    )
    assert shown is not None
    assert float(shown[1]) == pytest.approx(worst, abs=0.1)


@pytest.mark.parametrize(
    "content",
    [
        Table((Column("name", BAD), Column("number", BAD)), [[BAD], [BAD, Cell(BAD, colour=BAD, share=0.5)]]),
        Photos([Photo(b"", (1, 1), BAD, [Stroke((0.0, 0.0), (1.0, 1.0), BAD)])]),
        Bar([(BAD, 0.5)]),
        Items([BAD]),
        Items([BAD], numbered=True),
        Preformatted(BAD),
    ],
    ids=lambda content: content.kind,
)
def test_every_kind_of_content_is_escaped(content: Content) -> None:
    """Text and attributes alike."""
    html = Page(
        title=BAD, heading=BAD, subtitle=BAD, verdict=Verdict(BAD, True), cards=[Card(BAD, BAD, BAD, BAD)],
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
    assert drawing.content.svg.count(escape(BAD, quote=False)) == 3


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
