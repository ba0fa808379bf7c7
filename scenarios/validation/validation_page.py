"""The report of the validation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from scenarios.report.page import Cell, Column, Emphasis, Items, Page, Table, Verdict, facts_table
from scenarios.report.page import Section as PageSection
from scenarios.validation.check import Check, Section, number, tally
from scenarios.validation.validation_figures import figure

_EMPHASIS: Mapping[str, Emphasis] = {"passed": "good", "failed": "bad", "skipped": "soft"}


def validation_page(sections: Sequence[Section], facts: Mapping[str, str]) -> str:
    """The page as HTML; ``facts`` are versions and circumstances."""
    counts = tally(sections)
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count or verdict != "skipped")
    return Page(
        title="validation",
        heading="Validation",
        subtitle=(
            "The vehicle model's numbers compared with closed forms, published tables and independent models. Each "
            "value must lie within the tolerance of its target; the bar shows the share of the tolerance that it uses."
        ),
        verdict=Verdict(verdicts, not counts["failed"]),
        sections=[
            *(_section(k, part) for k, part in enumerate(sections)),
            PageSection("Software", content=[facts_table(facts)]),
        ],
    ).html()


def _section(index: int, part: Section) -> PageSection:
    """The checks, the sources that their last column numbers, and the plots."""
    sources = list(dict.fromkeys(check.source for check in part.checks))
    columns = [
        Column("text", "quantity"),
        *(Column("number", title) for title in ("model", "target", "tolerance")),
        Column("text", "used"),
        Column("text"),
        Column("number", "source"),
    ]
    table = Table(columns, [_row(check, 1 + sources.index(check.source)) for check in part.checks])
    plots = [figure(plot, f"validation-{index}-{k}") for k, plot in enumerate(part.plots)]
    return PageSection(part.title, part.text, [table, Items(sources, numbered=True), *plots])


def _row(check: Check, source: int) -> list[str | Cell]:
    emphasis = _EMPHASIS[check.verdict]
    share = None if check.used is None else 1.0 if math.isnan(check.used) else min(1.0, check.used)
    return [
        check.name + (f" ({check.remark})" if check.remark else ""),
        "–" if check.value is None else f"{number(check.value, check.tolerance)} {check.unit}",
        f"{number(check.target, check.tolerance)} {check.unit}",
        f"± {check.tolerance:.2g}",
        Cell("", "bad" if check.verdict == "failed" else "", share=share),
        Cell(check.verdict, emphasis),
        Cell(str(source), "soft"),
    ]
