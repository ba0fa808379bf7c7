"""The report of an assessment."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from scenarios.report.page import Cell, Column, Page, Row, Section, Table, outcome_verdict, software_section
from scenarios.results.manifest import versions
from scenarios.standards.assessment import Assessment
from scenarios.standards.levels import Judgement
from scenarios.standards.manoeuvre import Manoeuvre
from scenarios.standards.manoeuvre_figures import figures
from scenarios.standards.quantities import BY_NAME

_TOGETHER: Final = "\N{NO-BREAK SPACE}"
_LEVELS: Final = (
    "The level of each standard that the combination reaches. Limits marked “from memory” were not checked against the "
    "text of the standard: look them up before you rely on them."
)


def assessment_page(assessment: Assessment) -> str:
    """The page as HTML."""
    vehicle = assessment.vehicle
    facts = [vehicle.summary, f"{vehicle.mass / 1e3:.1f} t", f"{vehicle.length:.2f} m"]
    if any(unit.steered_axles for unit in vehicle.units[1:]):
        facts.append(f"trailer steering: {assessment.trailer_steering}")
    return Page(
        title=f"{vehicle.name} · assessment",
        heading=f"{vehicle.name} in standard manoeuvres",
        subtitle=" · ".join(facts),
        sections=list(_sections(assessment)),
    ).html()


def bounds_text(judgement: Judgement) -> str:
    """The bounds of a criterion in one line, in the units shown, with levels as L1, L2 and so on."""
    quantity = BY_NAME[judgement.criterion.quantity]
    sign = "≤" if judgement.criterion.at_most else "≥"
    bounds = [f"{level.replace('level ', 'L')} {quantity.text(bound)}".strip() for level, bound in judgement.bounds]
    return f"{sign}{_TOGETHER}" + " · ".join(bound.replace(" ", _TOGETHER) for bound in bounds)


def _sections(assessment: Assessment) -> Iterator[Section]:
    yield Section("Levels", _LEVELS, [_levels(assessment)])
    for manoeuvre in assessment.manoeuvres:
        yield Section(
            manoeuvre.title,
            manoeuvre.how,
            [*figures(assessment.vehicle, manoeuvre), _measured(assessment, manoeuvre)],
            outcome_verdict(manoeuvre.outcome),
        )
    yield software_section(versions())


def _levels(assessment: Assessment) -> Table:
    columns = [Column("name"), Column("number", "measured"), Column("text", "reached")]
    rows: list[Row] = []
    for judgement in assessment.judgements:
        criterion, quantity = judgement.criterion, BY_NAME[judgement.criterion.quantity]
        bad = judgement.reached in ("none", "missed", "not measured")
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
