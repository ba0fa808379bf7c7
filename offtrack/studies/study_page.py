"""Reports of studies and of compared finished runs, with the sensitivity to drawn keys."""

import csv
import io
import os
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from offtrack.reports import page
from offtrack.reports.page import (
    Cell,
    Column,
    Figure,
    Items,
    Page,
    Player,
    Preformatted,
    Section,
    Table,
    software_section,
)
from offtrack.reports.player.encoding import encoded
from offtrack.reports.plots import ESTIMATED, TRUE, drawn
from offtrack.reports.sections import scenario_facts
from offtrack.studies import study_figures as figures
from offtrack.studies.case import Case, Outcome, machines
from offtrack.studies.draws import CONFIDENCE, MEASURES, Analysis, Sensitivity, analysed
from offtrack.studies.study import Study
from offtrack.studies.study_figures import explorer, played_together
from offtrack.studies.table import Quantity, Row, exceeding, shown_quantities, spreads, text_of
from scenarios.results.run_summary import versions

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
    yield Section("Sensitivity", _MEANINGS[design.method] + interval, [_sensitivity_table(design, analyses)])
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


def _sensitivity_table(design: Sensitivity, analyses: Sequence[Analysis]) -> Table:
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


def study_page(
    title: str, study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row], links: Sequence[str] = ()
) -> str:
    """The page as HTML; ``links`` are the addresses of the runs' pages, empty where there is none."""
    seeds = ", ".join(map(str, study.seeds))
    facts = (study.scenario, _facts(outcomes[0].case, study.axes), _counted(outcomes), f"seeds {seeds}")
    file = Section("Study file", "offtrack sweep runs this file.", [Preformatted(study.to_toml())])
    changed = ", ".join(f"{key} = {value}" for key, value in study.fixed)
    made_on = machines([outcome.provenance for outcome in outcomes])
    return Page(
        title=title,
        heading=title,
        subtitle=" · ".join(filter(None, facts)),
        changes=f"Changed in all runs: {changed}" if changed else "",
        sections=[
            *_sections(outcomes, rows, links),
            *_drawn(study, outcomes, rows),
            *machine_sections(made_on),
            file,
            software_section(versions()),
        ],
        wide=True,
    ).html()


def _drawn(study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row]) -> Iterator[Section]:
    """Spread over the drawn values, with confidence intervals."""
    if not study.draws:
        return
    if study.draws.sensitivity:
        yield from sensitivity_sections(study.draws.sensitivity, outcomes)
        return
    keys = [f"{key}: {one.kind} {', '.join(map(str, one.values))}" for key, one in study.draws.distributions.items()]
    sample = study.draws.sample
    text = f"{sample.count} draws ({sample.method}, seed {sample.seed}) for each point." if sample else ""
    if study.stop and sample:
        text = (
            f"At most {text} A point ends after the first multiple of {study.stop.batch} draws at which half the width "
            f"of the interval of each limit's probability is at most {100.0 * study.stop.half_width:g} %."
        )
    yield Section("Drawn values", text, [Items(keys)])
    if study.limits:
        text = (
            f"Share of the runs beyond the limit or not completed, with the {100 * CONFIDENCE:.0f} % interval of its "
            "probability (Clopper-Pearson)."
        )
        yield Section("Limits", text, [_limits(study, outcomes, rows)])
    quantities = shown_quantities(rows)
    yield Section("Spread", "Over all draws of a point.", [_spread_table(outcomes, quantities)])
    for quantity in quantities[:2]:
        text = (
            f"Mean of the draws so far, with its {100 * CONFIDENCE:.0f} % interval for independent draws; Latin "
            "hypercubes and Sobol sequences converge faster."
        )
        yield Section(f"Convergence: {quantity.meaning}", text, [figures.convergence(outcomes, quantity)])


def _limits(study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row]) -> Table:
    columns = [Column("text", key) for key, _ in rows[0].axes] + [Column("text", "limit")]
    columns += [Column("number", name) for name in ("beyond", "runs", "share", "from", "to")]
    lines: list[page.Row] = []
    for row in rows:
        for path, limit in study.limits.items():
            found = exceeding(outcomes, row.axes, path, limit)
            shares = (f"{100.0 * share:.1f} %" for share in (found.share, *found.interval()))
            values = (value for _, value in row.axes)
            lines.append([*values, f"{path} > {limit:g}", str(found.beyond), str(found.runs), *shares])
    return Table(columns, lines)


def _spread_table(outcomes: Sequence[Outcome], quantities: Sequence[Quantity]) -> Table:
    names = ("mean", "deviation", "5 %", "median", "95 %", "largest")
    axes = [key for key, _ in outcomes[0].case.axes]
    columns = [Column("text", key) for key in (*axes, "quantity")] + [Column("number", name) for name in names]
    lines: list[page.Row] = []
    for quantity in quantities:
        for spread in spreads(outcomes, quantity):
            known = spread.known
            if len(known) < 2:
                continue
            low, middle, high = np.percentile(known, (5.0, 50.0, 95.0))
            numbers = (known.mean(), known.std(ddof=1), low, middle, high, known.max())
            values = (value for _, value in spread.axes)
            shown = (text_of(quantity, float(number)) for number in numbers)
            lines.append([*values, f"{quantity.label} [{quantity.unit}]", *shown])
    return Table(columns, lines)


def machine_sections(made_on: Sequence[str]) -> Iterator[Section]:
    """A word of caution on runs of several machines."""
    if len(made_on) > 1:
        text = (
            "Equal seeds give bitwise equal runs on one machine; on others the last digits may differ. runs.csv says "
            "where each run was made."
        )
        yield Section("Machines", text, [Items(made_on)])


def finished_runs_page(outcomes: Sequence[Outcome], rows: Sequence[Row], links: Sequence[str] = ()) -> str:
    """The page on finished runs that are compared, as HTML; ``links`` are the addresses of their pages."""
    names = [f"{run}: {_facts(o.case)}" for o in outcomes for _, run in o.case.axes]
    return Page(
        title="Comparison of runs",
        heading="Comparison of runs",
        subtitle=_counted(outcomes),
        sections=[
            Section("Runs", content=[Items(names)]),
            *_sections(outcomes, rows, links),
            software_section(versions()),
        ],
        wide=True,
    ).html()


def _facts(case: Case, varied: Collection[str] = ()) -> str:
    """Vehicle, law and estimator of a run, without the keys that are varied; empty if its files are gone by now."""
    try:
        scenario = case.resolved().model_dump(mode="json", exclude_none=True)
    except ValueError:
        return ""
    return scenario_facts({key: value for key, value in scenario.items() if key not in varied})


def _counted(outcomes: Sequence[Outcome]) -> str:
    return f"{len(outcomes)} runs, {sum(outcome.completed for outcome in outcomes)} completed"


_RUNS = (
    "Every run as a line over its values, and as a dot over two of them. Red: it did not complete its course. A click "
    "opens the page that plays the run"
)


def _explored(outcomes: Sequence[Outcome], links: Sequence[str]) -> Iterator[Section]:
    links = list(links) or [""] * len(outcomes)
    if found := explorer(outcomes, links):
        paged = sum(map(bool, links))
        yield Section("Runs", f"{_RUNS}{'' if paged == len(links) else f'; {paged} runs have one'}.", [found])


def _sections(outcomes: Sequence[Outcome], rows: Sequence[Row], links: Sequence[str]) -> Iterator[Section]:
    shown = shown_quantities(rows)
    columns = Items([f"{q.label} [{q.unit}]: {q.meaning}" for q in shown])
    text = (
        "One row for each combination of the varied keys, over all seeds: root mean square of RMS values, maximum of "
        "the others. Bold: the smallest value of its column."
    )
    yield Section("Table", text, [_table(rows), columns])
    yield from _explored(outcomes, links)
    if playback := played_together(figures.alike(outcomes)):
        text = "Runs of the first seed, laid over each other; other varied keys have their first value."
        yield Section("Playback", text, [Player(encoded(playback))])
    has_off_tracking = any(row.numbers["off_tracking.true_rms_m"] is not None for row in rows)
    drives = figures.drives_of(outcomes) if has_off_tracking else []
    if drives:
        text = "The follow point should retrace the hitch's path. First seed, first value of every other varied key."
        if len(drives) > figures.MOST_LINES:
            text += f" The first {figures.MOST_LINES} of {len(drives)} runs are drawn."
            drives = drives[: figures.MOST_LINES]
        yield Section("Plan view", text, [figures.plan(drives)])
        text = "The same runs over the distance that the hitch has driven."
        yield Section("Off-tracking", text, [figures.off_tracking(drives)])
    axis = figures.numeric_axis(rows)
    if axis:
        for quantity in shown[:3]:
            yield Section(f"{quantity.meaning}, over {axis}", content=[figures.trend(rows, axis, quantity)])


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


def page_link(directory: Path, folder: Path) -> str:
    """Address of a run's own page from a folder; empty if there is none."""
    report = directory / "report.html"
    return Path(os.path.relpath(report, folder)).as_posix() if report.is_file() else ""


def names_of_runs(directories: Sequence[Path]) -> list[str]:
    """Short names that differ: the last parts of the paths, as many as it takes.

    Raises:
        ValueError: one line, if a run is named twice.
    """
    paths = [directory.absolute() for directory in directories]
    if len(set(paths)) < len(paths):
        raise ValueError("a run is named twice")
    count = 1
    while len({path.parts[-count:] for path in paths}) < len(paths):
        count += 1
    return [os.path.join(*path.parts[-count:]) for path in paths]
