"""The report of a study."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from scenarios.report import page
from scenarios.report.page import Cell, Column, Items, Page, Preformatted, Section, Table, software_section
from scenarios.results.manifest import versions
from scenarios.studies import study_figures as figures
from scenarios.studies.case import Outcome
from scenarios.studies.study import Study
from scenarios.studies.table import Row, shown_quantities, text_of


def study_page(title: str, study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row]) -> str:
    """The page as HTML."""
    finished = sum(outcome.completed for outcome in outcomes)
    seeds = ", ".join(map(str, study.seeds))
    return Page(
        title=title,
        heading=title,
        subtitle=f"{study.scenario} · {len(outcomes)} runs, {finished} completed · seeds {seeds}",
        sections=list(_sections(study, outcomes, rows)),
        wide=True,
    ).html()


def _sections(study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row]) -> Iterator[Section]:
    shown = shown_quantities(rows)
    columns = Items([f"{q.label} [{q.unit}]: {q.meaning}" for q in shown])
    text = (
        "One row for each combination of the varied keys, over all seeds: root mean square of RMS values, maximum of "
        "the others. Bold: the smallest value of its column."
    )
    yield Section("Table", text, [_table(rows), columns])
    drives = figures.drives_of(outcomes) if _has_off_tracking(rows) else []
    if drives:
        text = "The follow point should retrace the hitch's path. First seed, first value of every other varied key."
        yield Section("Plan view", text, [figures.plan(drives)])
        text = "The same runs over the distance that the hitch has driven."
        yield Section("Off-tracking", text, [figures.off_tracking(drives)])
    axis = figures.numeric_axis(rows)
    if axis:
        for quantity in shown[:3]:
            meaning = f"{quantity.meaning[0].upper()}{quantity.meaning[1:]}"
            yield Section(f"{meaning}, over {axis}", content=[figures.trend(rows, axis, quantity)])
    yield Section("Study file", "offtrack sweep runs this file.", [Preformatted(study.to_toml())])
    yield software_section(versions())


def _has_off_tracking(rows: Sequence[Row]) -> bool:
    return any(row.numbers["off_tracking.true_rms_m"] is not None for row in rows)


def _table(rows: Sequence[Row]) -> Table:
    quantities = shown_quantities(rows)
    columns = [Column("text", key) for key, _ in rows[0].axes] + [Column("text", "completed")]
    columns += [Column("number", f"{q.label} [{q.unit}]") for q in quantities]
    best = {q.path: min(v for row in rows if (v := row.numbers[q.path]) is not None) for q in quantities}
    lines: list[page.Row] = []
    for row in rows:
        endings = f" ({', '.join(row.endings)})" if row.endings else ""
        numbers = [(q, row.numbers[q.path]) for q in quantities]
        lines.append(
            [
                *(value for _, value in row.axes),
                f"{row.completed} of {row.runs}{endings}",
                *(
                    Cell(text_of(q, value), "best" if value == best[q.path] and len(rows) > 1 else "")
                    for q, value in numbers
                ),
            ]
        )
    return Table(columns, lines)
