"""Result directory of an assessment: report with figures and playback, numbers, log and drawing of every manoeuvre."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes

from offtrack.exchange.drawings import DrivenPath, drawing, write_drawing
from offtrack.reports import page, plots
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.playback import (
    Line,
    Playback,
    PlayedRun,
    Reading,
    Trail,
    curves,
    motion_charts,
    peak_of,
    unit_body,
)
from offtrack.reports.run_files import write_json
from offtrack.reports.sections import groups
from offtrack.studies.standards.assessment import UNDECIDED, Assessment, AssessmentMatrix, Judgement
from offtrack.studies.standards.open_loop import response_of
from offtrack.studies.standards.proving_ground import Manoeuvre, axle_paths
from offtrack.studies.standards.static_rollover import threshold
from offtrack.studies.standards.steady_driving import steer_over_acceleration
from scenarios.assembly.adapters import outlines
from scenarios.results.log import Log, write_log
from scenarios.results.run_directory import appearing_at_once
from scenarios.results.run_summary import versions
from scenarios.results.trailer_signals import motion_columns
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.frames import FloatArray

_OF_WHOLE_DRIVES: Final = ("random_steer",)
_CHANGE: Final = (45.0, 330.0)  # of the lane change along the road [m]


def figures(case: Assessment, manoeuvre: Manoeuvre, name: str) -> Iterator[page.Figure]:
    """The figures of a manoeuvre; none if it ended before anything had moved. ``name`` is unique on the page."""
    if len(manoeuvre.log) < 2 or (manoeuvre.outcome != "completed" and manoeuvre.key in _OF_WHOLE_DRIVES):
        return
    if manoeuvre.key in _SEEN_FROM_ABOVE:
        yield plots.plan_figure(_played(case, manoeuvre, name))
    for draw in _FIGURES.get(manoeuvre.key, ()):
        with plots.drawn(f"{name}-{draw.__name__}") as (drawing, ax):
            draw(case.vehicle, manoeuvre, ax)
        yield drawing.content


def _paths(vehicle: Vehicle, manoeuvre: Manoeuvre, ax: Axes) -> None:
    """Lateral positions of the first and the last axle over the position along the road, stretched."""
    front, rear = axle_paths(vehicle, manoeuvre.log)
    ax.plot(*front.T, color=plots.TRUE, label="front axle", zorder=4)
    ax.plot(*rear.T, color=plots.ESTIMATED, label=f"last axle ({vehicle.units[-1].name})", zorder=5)
    if manoeuvre.course is not None:
        style: Any = {"color": plots.INK, "linewidth": 0.9, "dashes": (5, 4), "zorder": 6}
        ax.plot(*manoeuvre.course.T, label="prescribed path", **style)
    span = _CHANGE if manoeuvre.key == "lane_change" else (0.0, float(front[-1, 0]))
    ax.set(xlim=span, xlabel="along the road [m]", ylabel="lateral [m], + left")


def _of_units(vehicle: Vehicle, ax: Axes, x: FloatArray, values: Callable[[str], FloatArray]) -> None:
    """Draw a curve for each unit; ``values`` by its name."""
    for unit, colour in zip(vehicle.units, plots.SERIES, strict=False):
        ax.plot(x, values(unit.name), color=colour, label=unit.name)


def _steer_over_acceleration(vehicle: Vehicle, manoeuvre: Manoeuvre, ax: Axes) -> None:
    """Steer angle over lateral acceleration on the circle."""
    acceleration, steer = steer_over_acceleration(vehicle, manoeuvre.log)
    ax.plot(acceleration / GRAVITY, np.degrees(steer), color=plots.TRUE, label="road-wheel angle")
    ax.set(xlim=(0.0, 0.26), xlabel="lateral acceleration [g], into the turn", ylabel="steer angle [°]")


def _frequency_response(vehicle: Vehicle, manoeuvre: Manoeuvre, ax: Axes) -> None:
    """Rearward amplification over frequency, measured and by linear theory."""
    response = response_of(vehicle, manoeuvre)
    ax.plot(response.frequency, response.theory, color=plots.GREY, linewidth=2.2, label="linear theory")
    ax.plot(response.frequency, response.measured, ".", color=plots.TRUE, markersize=4, label="measured")
    ax.set(xlim=(0.0, float(response.frequency[-1])), ylim=(0.0, None))
    ax.set(xlabel="frequency [Hz]", ylabel="rearward amplification [-]")


def _load_transfers(vehicle: Vehicle, manoeuvre: Manoeuvre, ax: Axes) -> None:
    """Load transfer of every unit over the slope of the tilt table."""
    log, tips = manoeuvre.log, manoeuvre.figures["rollover_threshold_g"]
    slope, end = log["slope"], tips
    _of_units(vehicle, ax, slope, lambda unit: np.abs(log[f"load_transfer_{unit}"]))
    if vehicle.has_springs:
        ax.axvline(tips, color=plots.GREY, linewidth=0.8, label="it tips")
    else:
        thresholds = [threshold(log, unit.name) for unit in vehicle.units]
        end = max(thresholds)
        for line, at in zip(ax.lines[:], thresholds, strict=False):
            ax.plot([slope[-1], at], [np.asarray(line.get_ydata())[-1], 1.0], ":", color=line.get_color())
    ax.axhline(1.0, color=plots.GREY, linewidth=0.8, dashes=(6, 3), label="one side carries nothing")
    ax.set(xlim=(0.0, 1.05 * end), ylim=(0.0, 1.08))
    ax.set(xlabel="slope of the table [-] = lateral acceleration in g", ylabel="load transfer [-]")


def _rolls(vehicle: Vehicle, manoeuvre: Manoeuvre, ax: Axes) -> None:
    """Load transfer of every unit over the lateral acceleration of the first one."""
    log, first = manoeuvre.log, vehicle.units[0].name
    a_y = np.abs(log[f"v_x_{first}"] * log[f"yaw_rate_{first}"]) / GRAVITY
    _of_units(vehicle, ax, a_y, lambda unit: np.abs(log[f"load_transfer_{unit}"]))
    ax.axvline(manoeuvre.figures["curve_rollover_g"], color=plots.GREY, linewidth=0.8, label="it tips")
    ax.set(xlim=(0.0, None), ylim=(0.0, 1.08))
    ax.set(xlabel="lateral acceleration of the tractor [g]", ylabel="load transfer [-]")


_SEEN_FROM_ABOVE: Final = ("turn", "roundabout", "aashto_turn", "ctsw_turn", "braking_split", "braking_in_turn")
_FIGURES: Final[dict[str, tuple[Callable[[Vehicle, Manoeuvre, Axes], None], ...]]] = {
    "lane_change": (_paths,),
    "straight": (_paths,),
    "steady_circle": (_steer_over_acceleration,),
    "random_steer": (_frequency_response,),
    "tilt": (_load_transfers,),
    "closing_curve": (_rolls,),
}


_DEGREES: Final = 180.0 / np.pi
_KEPT: Final = ("x_", "y_", "psi_", "v_x_", "yaw_rate_", "roll_", "pitch_", "steer_")  # signals of a page


def assessment_playback(matrix: AssessmentMatrix) -> Playback | None:
    """Everything that a page shows of the manoeuvres over time; None if nothing moved."""
    several = len(matrix.cases) > 1
    runs = [
        _played(case, manoeuvre, f"{manoeuvre.title}{f' · {name}' if several else ''}")
        for case, name in zip(matrix.cases, matrix.names, strict=True)
        for manoeuvre in case.manoeuvres
        if len(manoeuvre.log) > 1 and f"x_{matrix.vehicle.units[0].name}" in manoeuvre.log
    ]
    if not runs:
        return None
    names, vehicle = {name: None for run in runs for name in run.log.names}, matrix.vehicle
    steer = [one for one in names if one.startswith("steer_") and "command" not in one]
    steered = curves({one: one.removeprefix("steer_").replace("_", " ") for one in steer}, 180.0 / np.pi)
    charts = motion_charts(list(names), [unit.name for unit in vehicle.units], steered)
    readings = tuple(_readings(vehicle))
    return Playback(title=vehicle.name, runs=tuple(runs), together=False, charts=tuple(charts), readings=readings)


def _played(case: Assessment, manoeuvre: Manoeuvre, name: str) -> PlayedRun:
    vehicle, log = case.vehicle, _shown_log(case.vehicle, manoeuvre.log)
    bodies, first = outlines(vehicle), vehicle.units[0].name
    turned = "articulation_1" if len(vehicle.units) > 1 else f"yaw_rate_{first}"
    last = vehicle.units[-1]
    return PlayedRun(
        name=name,
        log=log,
        peak=peak_of(log, turned),
        bodies=tuple(unit_body(unit, log) for unit in bodies),
        trails=(
            Trail("path of the front axle", "true", 0, (bodies[0].axles[0], 0.0)),
            Trail(f"path of the last axle ({last.name})", "estimated", len(bodies) - 1, (bodies[-1].axles[-1], 0.0)),
        ),
        lines=() if manoeuvre.course is None else (Line("prescribed path", "grey", manoeuvre.course),),
    )


def _shown_log(vehicle: Vehicle, log: Log) -> Log:
    """Motion and steering of the log, with articulations and lateral accelerations."""
    kept = [signal for signal in log.signals if signal.name == "time" or signal.name.startswith(_KEPT)]
    motions = motion_columns({signal.name: log[signal.name] for signal in log.signals}, vehicle)
    return Log.of([*((signal, log[signal.name]) for signal in kept), *motions])


def _readings(vehicle: Vehicle) -> Iterator[Reading]:
    first, last = vehicle.units[0].name, vehicle.units[-1].name
    yield Reading("speed", f"v_x_{first}", "km/h", 3.6, 1)
    yield Reading("front axle steer", f"steer_{first}", "°", _DEGREES, 2)
    yield Reading(f"lateral acceleration, {first}", f"lateral_acceleration_{first}", "m/s²", 1.0, 2)
    yield Reading(f"lateral acceleration, {last}", f"lateral_acceleration_{last}", "m/s²", 1.0, 2)
    yield Reading("articulation", "articulation_1", "°", _DEGREES, 2)


def write_drawings(case: Assessment, folder: Path, before: str, kinds: Sequence[str]) -> None:
    """Write ``<before><manoeuvre>.<format>`` of every manoeuvre that has a path and moved along it."""
    for manoeuvre in case.manoeuvres:
        if kinds and manoeuvre.course is not None and len(manoeuvre.log) > 1:
            drawn = drawing(_driven(case, manoeuvre))
            for kind in kinds:
                write_drawing(drawn, folder / f"{before}{manoeuvre.key}.{kind}", kind)


def _driven(case: Assessment, manoeuvre: Manoeuvre) -> DrivenPath:
    units = outlines(case.vehicle)
    return DrivenPath(
        title=f"{case.vehicle.name}: {manoeuvre.title}",
        notes=(manoeuvre.how, f"load: {case.load}, outcome: {manoeuvre.outcome}"),
        units=units,
        poses=tuple(unit.poses(manoeuvre.log) for unit in units),
        steer=tuple(unit.axle_steer(manoeuvre.log) for unit in units),
        time=manoeuvre.log["time"],
        front_axle_x=case.vehicle.units[0].steered_axles[0].x,
        course=manoeuvre.course,
    )


BY_NAME: Final = groups()["assessment"].numbers


_BAD: Final = ("none", "missed", "not measured")
_OPEN: Final = (*_BAD, UNDECIDED)
_TOGETHER: Final = "\N{NO-BREAK SPACE}"
_LEVELS: Final = (
    "The level of each standard that the combination reaches. Limits marked “from memory” were not checked against the "
    "text of the standard: look them up before you rely on them."
)


_MATRIX: Final = (
    "Every measured quantity in each case, with the levels of the standards that it reaches. Red: a limit is missed. "
    "A dash: not measured in this case. Manoeuvres that turn to no side are driven once in each load case."
)


def assessment_page(matrix: AssessmentMatrix) -> str:
    """The page as HTML."""
    vehicle, assessment = matrix.vehicle, matrix.cases[0]
    facts = [vehicle.summary, f"{vehicle.mass / 1e3:.1f} t", f"{vehicle.length:.2f} m"]
    if any(unit.steered_axles for unit in vehicle.units[1:]):
        given = getattr(assessment.trailer_steering, "parameters", {})
        facts.append(
            " ".join([f"trailer steering: {assessment.trailer_steering}", *(f"{k}={v}" for k, v in given.items())])
        )
    return page.Page(
        title=f"{vehicle.name} · assessment",
        heading=f"{vehicle.name} in standard manoeuvres",
        subtitle=" · ".join(facts),
        verdict=_verdict(matrix),
        answer=_answer(matrix),
        sections=list(_sections(matrix)),
    ).html()


def _verdict(matrix: AssessmentMatrix) -> page.Verdict:
    """How many of the limits are met, over all cases."""
    reached = [judgement.reached for case in matrix.cases for judgement in case.judgements]
    if not reached:
        ended = sum(one.outcome != "completed" for case in matrix.cases for one in case.manoeuvres)
        return page.Verdict(f"{ended} not completed" if ended else "completed, no limits apply", not ended)
    met = sum(one not in _OPEN for one in reached)
    return page.Verdict(f"{met} of {len(reached)} limits met", met == len(reached))


def _answer(matrix: AssessmentMatrix) -> list[str]:
    """Manoeuvres that were not completed, and the limits that are missed, by how much."""
    found = list[str]()
    for case, name in zip(matrix.cases, matrix.names, strict=True):
        at = f" ({name})" if len(matrix.cases) > 1 else ""
        found += [f"{one.title}{at}: {one.outcome}." for one in case.manoeuvres if one.outcome != "completed"]
        found += [f"{_missed(one)}{at}." for one in case.judgements if one.reached in _OPEN]
    return page.some(found, _MOST_SENTENCES)


def _missed(judgement: Judgement) -> str:
    quantity, standard = BY_NAME[judgement.criterion.quantity], judgement.criterion.standard
    if judgement.reached in ("not measured", UNDECIDED):
        return f"{quantity.label} {judgement.reached}: {bounds_text(judgement)} by {standard}"
    (_, bound), side = judgement.bounds[-1], "at least" if judgement.criterion.at_least else "at most"
    by, measured = quantity.said(abs(judgement.measured - bound)), quantity.text(judgement.measured)
    return f"{quantity.label} missed by {by}: {measured}, {side} {quantity.text(bound)} by {standard}"


_MOST_SENTENCES: Final = 5


def bounds_text(judgement: Judgement, *, relative: bool = False) -> str:
    """The bounds of a criterion in one line, in the units shown, with levels as L1, L2 and so on.

    ``relative`` bounds are those of every case: multiples of another quantity, if the criterion is one.
    """
    quantity = BY_NAME[judgement.criterion.quantity]
    sign = "≥" if judgement.criterion.at_least else "≤"
    if relative and judgement.criterion.times is not None:
        of = BY_NAME[judgement.criterion.times].label.lower()
        return f"{sign}{_TOGETHER}" + " · ".join(f"{bound:g} times the {of}" for _, bound in judgement.criterion.bounds)
    bounds = [f"{level.replace('level ', 'L')} {quantity.text(bound)}".strip() for level, bound in judgement.bounds]
    return f"{sign}{_TOGETHER}" + " · ".join(bound.replace(" ", _TOGETHER) for bound in bounds)


def _sections(matrix: AssessmentMatrix) -> Iterator[page.Section]:
    several = len(matrix.cases) > 1
    endings = [f" · {name}" if several else "" for name in matrix.names]
    if matrix.warnings:
        yield page.Section("Warnings", content=[page.Items(matrix.warnings)])
    if several:
        yield page.Section("Manoeuvres and cases", _MATRIX, [matrix_table(matrix, limits=True)])
    for case, ending in zip(matrix.cases, endings, strict=True):
        if case.judgements:
            yield page.Section(f"Levels{ending}", _LEVELS, [levels_table(case)])
    if playback := assessment_playback(matrix):
        yield page.Section("Playback", "Choose a manoeuvre to see it driven.", [page.Player(encoded(playback))])
    for case, ending in zip(matrix.cases, endings, strict=True):
        for manoeuvre in case.manoeuvres:
            name = f"{case.load}-{case.conditions.hand}-{manoeuvre.key}" if several else manoeuvre.key
            yield page.Section(
                f"{manoeuvre.title}{ending}",
                manoeuvre.how,
                [*figures(case, manoeuvre, name), _measured(case, manoeuvre)],
                page.outcome_verdict(manoeuvre.outcome),
            )
    yield page.software_section(versions())


def matrix_table(matrix: AssessmentMatrix, *, limits: bool) -> page.Table:
    """A row for each quantity below the title of its manoeuvre, a column for each case; a last one with the limits."""
    rows: list[page.Row] = []
    for key in dict.fromkeys(manoeuvre.key for case in matrix.cases for manoeuvre in case.manoeuvres):
        driven = [next((one for one in case.manoeuvres if one.key == key), None) for case in matrix.cases]
        title = next(one.title for one in driven if one is not None)
        outcomes = [page.Cell("–") if one is None else outcome_cell(one) for one in driven]
        last = [""] if limits else []
        rows += [[title], ["outcome", *outcomes, *last]]
        for name in dict.fromkeys(name for one in driven if one is not None for name in one.figures):
            values = [math.nan if one is None else one.figures.get(name, math.nan) for one in driven]
            if any(math.isfinite(value) for value in values):
                cells = [judged_cell(case, name, value) for case, value in zip(matrix.cases, values, strict=True)]
                rows.append([BY_NAME[name].label, *cells, *([limits_text(matrix, name)] if limits else [])])
    columns = [page.Column("name"), *(page.Column("number", name) for name in matrix.names)]
    return page.Table([*columns, *([page.Column("note", "limits")] if limits else [])], rows)


def limits_text(matrix: AssessmentMatrix, name: str) -> str:
    """The limits on a quantity, each with document and clause."""
    by_criterion = {
        (one.criterion.standard, one.criterion.source): one
        for case in matrix.cases
        for one in case.judgements
        if one.criterion.quantity == name
    }
    return "; ".join(
        f"{bounds_text(judgement, relative=True)}: {standard} ({source})"
        for (standard, source), judgement in by_criterion.items()
    )


def outcome_cell(manoeuvre: Manoeuvre) -> page.Cell:
    """Outcome of a manoeuvre in a case."""
    return page.Cell(manoeuvre.outcome, "good" if manoeuvre.outcome == "completed" else "bad")


def judged_cell(case: Assessment, name: str, value: float) -> page.Cell:
    """A measured quantity with the levels that it reaches."""
    judgements = [judgement for judgement in case.judgements if judgement.criterion.quantity == name]
    reached = [judgement.reached for judgement in judgements]
    text = BY_NAME[name].text(value)
    if not judgements or not math.isfinite(value):
        return page.Cell(text)
    return _reached_cell(f"{text} ({', '.join(dict.fromkeys(reached))})", reached)


def _reached_cell(text: str, reached: Sequence[str]) -> page.Cell:
    if any(one in _BAD for one in reached):
        return page.Cell(text, "bad")
    return page.Cell(text) if UNDECIDED in reached else page.Cell(text, "good")


def levels_table(assessment: Assessment) -> page.Table:
    """A row for each limit of the standards that applies."""
    rows: list[page.Row] = []
    for judgement in assessment.judgements:
        criterion, quantity = judgement.criterion, BY_NAME[judgement.criterion.quantity]
        reached = _reached_cell(judgement.reached, (judgement.reached,))
        measured = " … ".join(map(quantity.text, judgement.ends or (judgement.measured,)))
        standard = f"{criterion.standard} ({criterion.source})"
        rows.append([quantity.label, measured, reached, bounds_text(judgement), standard])
    columns = [page.Column("name", "quantity"), page.Column("number", "measured"), page.Column("text", "reached")]
    return page.Table([*columns, page.Column("note", "limits"), page.Column("note", "standard")], rows)


def _measured(assessment: Assessment, manoeuvre: Manoeuvre) -> page.Table:
    """A table of the measured quantities, compared with linear theory where there is one."""
    theory = {name: assessment.linear[name] for name in manoeuvre.figures if name in assessment.linear}
    rows: list[page.Row] = []
    for name, value in manoeuvre.figures.items():
        quantity = BY_NAME[name]
        if math.isfinite(value) or manoeuvre.outcome != "completed":
            linear = [quantity.text(theory[name]) if name in theory else ""] if theory else []
            rows.append([quantity.label, quantity.text(value), *linear, quantity.meaning])
    numbers = (
        [page.Column("number", "measured"), page.Column("number", "linear theory")]
        if theory
        else [page.Column("number")]
    )
    return page.Table([page.Column("name"), *numbers, page.Column("note")], rows)


def write_assessment(assessment: AssessmentMatrix, directory: Path, drawings: Sequence[str] = ()) -> None:
    """Write ``report.html``, ``assessment.json`` and ``<manoeuvre>.parquet``; the directory appears complete.

    With several cases the logs are ``<load>-<hand>-<manoeuvre>.parquet``. Drawings have the same names as the logs.

    Raises:
        ValueError: if the directory exists and is not empty.
    """
    with appearing_at_once(directory) as folder:
        (folder / "report.html").write_text(assessment_page(assessment), encoding="utf-8")
        write_json(folder / "assessment.json", assessment.summary())
        for case in assessment.cases:
            before = f"{case.load}-{case.conditions.hand}-" if len(assessment.cases) > 1 else ""
            for manoeuvre in case.manoeuvres:
                write_log(manoeuvre.log, folder / f"{before}{manoeuvre.key}.parquet")
            write_drawings(case, folder, before, drawings)
