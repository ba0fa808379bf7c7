"""Result directory of an assessment: report, numbers, log and drawing of every manoeuvre."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from offtrack.exchange.drawings import DrivenPath, axle_steer, drawing, unit_poses, write_drawing
from offtrack.reports.page import (
    Cell,
    Column,
    Items,
    Page,
    Player,
    Row,
    Section,
    Table,
    outcome_verdict,
    software_section,
)
from offtrack.reports.player.encoding import encoded
from offtrack.reports.sections import groups
from offtrack.studies.standards.assessment import Assessment, AssessmentMatrix
from offtrack.studies.standards.assessment_figures import assessment_playback, figures
from offtrack.studies.standards.comparison import Judgement
from offtrack.studies.standards.proving_ground import Manoeuvre
from scenarios.assembly.adapters import outlines
from scenarios.results.log import write_log
from scenarios.results.run_directory import appearing_at_once
from scenarios.results.run_summary import versions


def write_drawings(case: Assessment, folder: Path, before: str, kinds: Sequence[str]) -> None:
    """Write ``<before><manoeuvre>.<format>`` of every manoeuvre that has a path and moved along it."""
    for manoeuvre in case.manoeuvres:
        if manoeuvre.course is not None and len(manoeuvre.log) > 1:
            drawn = drawing(_driven(case, manoeuvre))
            for kind in kinds:
                write_drawing(drawn, folder / f"{before}{manoeuvre.key}.{kind}", kind)


def _driven(case: Assessment, manoeuvre: Manoeuvre) -> DrivenPath:
    units = outlines(case.vehicle)
    return DrivenPath(
        title=f"{case.vehicle.name}: {manoeuvre.title}",
        notes=(manoeuvre.how, f"load: {case.load}, outcome: {manoeuvre.outcome}"),
        units=units,
        poses=tuple(unit_poses(manoeuvre.log, unit) for unit in units),
        steer=tuple(axle_steer(manoeuvre.log, unit) for unit in units),
        time=manoeuvre.log["time"],
        front_axle_x=case.vehicle.units[0].steered_axles[0].x,
        course=manoeuvre.course,
    )


BY_NAME: Final = groups()["assessment"].numbers


_BAD: Final = ("none", "missed", "not measured")
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
        facts.append(f"trailer steering: {assessment.trailer_steering}")
    return Page(
        title=f"{vehicle.name} · assessment",
        heading=f"{vehicle.name} in standard manoeuvres",
        subtitle=" · ".join(facts),
        sections=list(_sections(matrix)),
    ).html()


def bounds_text(judgement: Judgement, *, relative: bool = False) -> str:
    """The bounds of a criterion in one line, in the units shown, with levels as L1, L2 and so on.

    ``relative`` bounds are those of every case: multiples of another quantity, if the criterion is one.
    """
    quantity = BY_NAME[judgement.criterion.quantity]
    sign = "≤" if judgement.criterion.at_most else "≥"
    if relative and judgement.criterion.times is not None:
        of = BY_NAME[judgement.criterion.times].label.lower()
        return f"{sign}{_TOGETHER}" + " · ".join(f"{bound:g} times the {of}" for _, bound in judgement.criterion.bounds)
    bounds = [f"{level.replace('level ', 'L')} {quantity.text(bound)}".strip() for level, bound in judgement.bounds]
    return f"{sign}{_TOGETHER}" + " · ".join(bound.replace(" ", _TOGETHER) for bound in bounds)


def _sections(matrix: AssessmentMatrix) -> Iterator[Section]:
    if matrix.warnings:
        yield Section("Warnings", content=[Items(matrix.warnings)])
    if playback := assessment_playback(matrix):
        yield Section("Playback", "Choose a manoeuvre to see it driven.", [Player(encoded(playback))])
    several = len(matrix.cases) > 1
    if several:
        yield Section("Manoeuvres and cases", _MATRIX, [matrix_table(matrix, limits=True)])
    for case, case_name in zip(matrix.cases, matrix.names, strict=True):
        ending = f" · {case_name}" if several else ""
        if case.judgements:
            yield Section(f"Levels{ending}", _LEVELS, [_levels(case)])
        for manoeuvre in case.manoeuvres:
            name = f"{case.load}-{case.conditions.hand}-{manoeuvre.key}" if several else manoeuvre.key
            yield Section(
                f"{manoeuvre.title}{ending}",
                manoeuvre.how,
                [*figures(case.vehicle, manoeuvre, name), _measured(case, manoeuvre)],
                outcome_verdict(manoeuvre.outcome),
            )
    yield software_section(versions())


def matrix_table(matrix: AssessmentMatrix, *, limits: bool) -> Table:
    """A row for each quantity below the title of its manoeuvre, a column for each case; a last one with the limits."""
    rows: list[Row] = []
    for key in dict.fromkeys(manoeuvre.key for case in matrix.cases for manoeuvre in case.manoeuvres):
        driven = [next((one for one in case.manoeuvres if one.key == key), None) for case in matrix.cases]
        title = next(one.title for one in driven if one is not None)
        outcomes = [Cell("–") if one is None else outcome_cell(one) for one in driven]
        last = [""] if limits else []
        rows += [[title], ["outcome", *outcomes, *last]]
        for name in dict.fromkeys(name for one in driven if one is not None for name in one.figures):
            values = [math.nan if one is None else one.figures.get(name, math.nan) for one in driven]
            if any(math.isfinite(value) for value in values):
                cells = [judged_cell(case, name, value) for case, value in zip(matrix.cases, values, strict=True)]
                rows.append([BY_NAME[name].label, *cells, *([limits_text(matrix, name)] if limits else [])])
    columns = [Column("name"), *(Column("number", name) for name in matrix.names)]
    return Table([*columns, *([Column("note", "limits")] if limits else [])], rows)


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


def outcome_cell(manoeuvre: Manoeuvre) -> Cell:
    """Outcome of a manoeuvre in a case."""
    return Cell(manoeuvre.outcome, "good" if manoeuvre.outcome == "completed" else "bad")


def judged_cell(case: Assessment, name: str, value: float) -> Cell:
    """A measured quantity with the levels that it reaches."""
    judgements = [judgement for judgement in case.judgements if judgement.criterion.quantity == name]
    reached = [judgement.reached for judgement in judgements]
    text = BY_NAME[name].text(value)
    if not judgements or not math.isfinite(value):
        return Cell(text)
    bad = any(one in _BAD for one in reached)
    return Cell(f"{text} ({', '.join(dict.fromkeys(reached))})", "bad" if bad else "good")


def _levels(assessment: Assessment) -> Table:
    columns = [Column("name"), Column("number", "measured"), Column("text", "reached")]
    rows: list[Row] = []
    for judgement in assessment.judgements:
        criterion, quantity = judgement.criterion, BY_NAME[judgement.criterion.quantity]
        bad = judgement.reached in _BAD
        rows.append(
            [
                quantity.label,
                quantity.text(judgement.measured),
                Cell(judgement.reached, "bad" if bad else "good"),
                bounds_text(judgement),
                f"{criterion.standard} ({criterion.source})",
            ]
        )
    return Table([*columns, Column("note", "limits"), Column("note", "standard")], rows)


def _measured(assessment: Assessment, manoeuvre: Manoeuvre) -> Table:
    """A table of the measured quantities, compared with linear theory where there is one."""
    theory = {name: assessment.linear[name] for name in manoeuvre.figures if name in assessment.linear}
    rows: list[Row] = []
    for name, value in manoeuvre.figures.items():
        quantity = BY_NAME[name]
        if math.isfinite(value) or manoeuvre.outcome != "completed":
            linear = [quantity.text(theory[name]) if name in theory else ""] if theory else []
            rows.append([quantity.label, quantity.text(value), *linear, quantity.meaning])
    numbers = [Column("number", "measured"), Column("number", "linear theory")] if theory else [Column("number")]
    return Table([Column("name"), *numbers, Column("note")], rows)


def write_assessment(assessment: AssessmentMatrix, directory: Path, drawings: Sequence[str] = ()) -> None:
    """Write ``report.html``, ``assessment.json`` and ``<manoeuvre>.parquet``; the directory appears complete.

    With several cases the logs are ``<load>-<hand>-<manoeuvre>.parquet``. Drawings have the same names as the logs.

    Raises:
        ValueError: if the directory exists and is not empty.
    """
    with appearing_at_once(directory) as folder:
        (folder / "report.html").write_text(assessment_page(assessment), encoding="utf-8")
        (folder / "assessment.json").write_text(json.dumps(assessment.summary(), indent=2) + "\n", encoding="utf-8")
        for case in assessment.cases:
            before = f"{case.load}-{case.conditions.hand}-" if len(assessment.cases) > 1 else ""
            for manoeuvre in case.manoeuvres:
                write_log(manoeuvre.log, folder / f"{before}{manoeuvre.key}.parquet")
            write_drawings(case, folder, before, drawings)
