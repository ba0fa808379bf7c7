"""Sensitivity in a study's report, and as a table in CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from scenarios.report import page
from scenarios.report.page import Column, Figure, Items, Section, Table
from scenarios.report.plots import ESTIMATED, TRUE, drawn
from scenarios.studies.case import Outcome
from scenarios.studies.sensitivity import CONFIDENCE, MEASURES, Analysis, Sensitivity, analysed

HEADINGS: Final = {"morris": ("μ*", "σ"), "sobol": ("first order", "total")}
_MOST_NAMED: Final = 40  # runs that were left out
_MEANINGS: Final = {
    "morris": (
        "Elementary effects: the change of a number while a key passes through its range (of a normal or lognormal "
        "distribution the central 95 %), from many places. μ* is the mean size of the effect, in the number's unit; σ "
        "its deviation: a σ as large as μ* means that the key acts unevenly or together with others."
    ),
    "sobol": (
        "Sobol indices: the share of a number's variance that a key explains by itself (first order), and with all its "
        "interactions (total). Shares can leave 0 to 1 by their uncertainty."
    ),
}


def sensitivity_sections(design: Sensitivity, outcomes: Sequence[Outcome]) -> Iterator[Section]:
    """Tables and figures of all analyses, and the runs that were left out."""
    analyses = analysed(design, outcomes)
    interval = f" Intervals: {100 * CONFIDENCE:.0f} %, by bootstrap."
    yield Section("Sensitivity", _MEANINGS[design.method] + interval, [_table(design, analyses)])
    for analysis in (one for one in analyses if one.indices):
        point = " · ".join(value for _, value in analysis.axes)
        title = f"Sensitivity: {analysis.quantity.meaning}{f' ({point})' if point else ''}"
        yield Section(title, "", [_figure(design, analysis, point)])
    if left_out := list(dict.fromkeys(title for one in analyses for title in one.left_out)):
        group = "trajectory" if design.method == "morris" else "base sample with all its runs"
        text = (
            f"A run that failed or did not complete its course has no number: its {group} is left out, so the indices "
            "hold for the others. What keeps runs from completing has indices of its own, 'not done'."
        )
        more = [f"and {len(left_out) - _MOST_NAMED} more"] if len(left_out) > _MOST_NAMED else []
        yield Section("Runs left out", text, [Items([*left_out[:_MOST_NAMED], *more])])


def sensitivity_csv(design: Sensitivity, outcomes: Sequence[Outcome]) -> str:
    """All indices as CSV: a row for each point, quantity and key."""
    text, analyses = io.StringIO(), analysed(design, outcomes)
    writer = csv.writer(text, lineterminator="\n")
    axes = [key for key, _ in analyses[0].axes] if analyses else []
    writer.writerow([*axes, "quantity", "unit", "key", *MEASURES[design.method], "groups", "left_out"])
    for one in analyses:
        for index in one.indices:
            numbers = ["" if value is None else value for value in index[1:]]
            values = (value for _, value in one.axes)
            row = [*values, one.quantity.path, one.quantity.unit, index.key, *numbers, one.groups, len(one.left_out)]
            writer.writerow(row)
    return text.getvalue()


def remarks(design: Sensitivity, analysis: Analysis) -> str:
    """Reasons why an analysis has no indices, or does not rest on all groups; empty if there are none."""
    name = "trajectories" if design.method == "morris" else "base samples"
    if not analysis.indices and analysis.groups == design.groups:
        return "does not vary"
    if not analysis.indices:
        return f"too few complete {name}: {analysis.groups} of {design.groups}, or no variation"
    return f"{analysis.groups} of {design.groups} {name}" if analysis.groups < design.groups else ""


def _table(design: Sensitivity, analyses: Sequence[Analysis]) -> Table:
    axes = [key for key, _ in analyses[0].axes] if analyses else []
    first, second = HEADINGS[design.method]
    columns = [Column("text", key) for key in (*axes, "quantity", "key")]
    columns += [Column("number", name) for name in (first, "±", second, "±")] + [Column("text", "")]
    lines: list[page.Row] = []
    for one in analyses:
        head = [*(value for _, value in one.axes), f"{one.quantity.label} [{one.quantity.unit}]"]
        for index in one.indices:
            numbers = ("" if value is None else f"{value:.3g}" for value in index[1:])
            lines.append([*head, index.key, *numbers, remarks(design, one)])
        if not one.indices:
            lines.append([*head, "", "", "", "", "", remarks(design, one)])
    return Table(columns, lines)


def _figure(design: Sensitivity, analysis: Analysis, point: str) -> Figure:
    """Both measures of every key with their intervals, the most influential key at the top."""
    indices = sorted(analysis.indices, key=lambda index: index.first)
    rows = np.arange(len(indices))
    name = f"sensitivity {analysis.quantity.path} {point}"
    with drawn(name, 1.2 + 0.34 * len(indices)) as (drawing, ax):
        firsts, seconds = ([index.first for index in indices], [index.second for index in indices])
        widths = [index.first_half_width for index in indices]
        ax.barh(rows + 0.18, firsts, 0.34, xerr=widths, color=TRUE, label=HEADINGS[design.method][0])
        others = [index.second_half_width or 0.0 for index in indices]
        ax.barh(rows - 0.18, seconds, 0.34, xerr=others, color=ESTIMATED, label=HEADINGS[design.method][1])
        ax.set_yticks(rows, [index.key for index in indices])
        unit = analysis.quantity.unit if design.method == "morris" else "share of the variance"
        ax.set(xlabel=f"{analysis.quantity.label} [{unit}]")
    return drawing.content
