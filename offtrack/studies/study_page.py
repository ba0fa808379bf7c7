"""Reports of studies and of compared finished runs, with the sensitivity to drawn keys."""

import csv
import io
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from offtrack.reports import page
from offtrack.reports.player.encoding import encoded
from offtrack.reports.plots import ESTIMATED, TRUE, drawn
from offtrack.reports.sections import changes, course_title, scenario_facts
from offtrack.studies import study_figures as figures
from offtrack.studies import table
from offtrack.studies.case import Case, Outcome, machines
from offtrack.studies.draws import CONFIDENCE, MEASURES, NOT_COMPLETED, Analysis, Sensitivity, analysed
from offtrack.studies.study import Study
from offtrack.studies.study_figures import explorer, played_together
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


def sensitivity_sections(design: Sensitivity, outcomes: Sequence[Outcome]) -> Iterator[page.Section]:
    """Figures and a table of all analyses, and the runs that were left out."""
    analyses = analysed(design, outcomes)
    interval = f" Intervals: {100 * CONFIDENCE:.0f} %, by bootstrap."
    drawings = [_figure(design, one) for one in analyses if one.indices]
    yield page.Section("Sensitivity", _MEANINGS[design.method] + interval, drawings)
    yield page.Section("Indices", content=[sensitivity_table(design, analyses)])
    if left_out := list(dict.fromkeys(title for one in analyses for title in one.left_out)):
        group = "trajectory" if design.method == "morris" else "base sample with all its runs"
        text = (
            f"A run that failed or did not complete its course has no number: its {group} is left out, so the indices "
            "hold for the others. What keeps runs from completing has indices of its own, 'not done'."
        )
        yield page.Section("Runs left out", text, [page.Items(page.some(left_out, _MOST_NAMED))])


def _sensitivity_answer(design: Sensitivity, outcomes: Sequence[Outcome]) -> list[str]:
    """The keys that a number depends on, the most influential first, a sentence for each of the first numbers."""
    sentences = []
    for one in analysed(design, outcomes):
        if one.indices and (one.quantity.better or one.quantity is NOT_COMPLETED):
            said = one.quantity.said if design.method == "morris" else "{:.2f}".format
            keys = sorted(one.indices, key=lambda index: -index.first)[:3]
            texts = [f"{figures.plain(index.key).partition(' [')[0]} {said(index.first)}" for index in keys]
            at = f" at {point}" if (point := figures.condition(one.axes)) else ""
            sentences.append(f"The {one.quantity.spoken}{at} depends most on {', then '.join(texts)}.")
    return sentences[:3] or ["No number depends on the drawn keys."]


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


def _remarks(design: Sensitivity, analysis: Analysis) -> str:
    """Reasons why an analysis has no indices, or does not rest on all groups; empty if there are none."""
    name = "trajectories" if design.method == "morris" else "base samples"
    if not analysis.indices and analysis.groups == design.groups:
        return "does not vary"
    if not analysis.indices:
        return f"too few complete {name}: {analysis.groups} of {design.groups}, or no variation"
    return f"{analysis.groups} of {design.groups} {name}" if analysis.groups < design.groups else ""


def sensitivity_table(design: Sensitivity, analyses: Sequence[Analysis], *, brief: bool = False) -> page.Table:
    """A row for each point, quantity and key; ``brief`` has the short names that fit a terminal."""
    axes = [key for key, _ in analyses[0].axes] if analyses else []
    first, second = HEADINGS[design.method]
    columns = [page.Column("text", figures.plain(key)) for key in (*axes, "quantity", "key")]
    columns += [page.Column("number", name) for name in (first, "±", second, "±")] + [page.Column("text", "")]
    lines: list[page.Row] = []
    for one in analyses:
        name = one.quantity.label if brief else one.quantity.meaning
        head = [*(value for _, value in one.axes), f"{name} [{one.quantity.unit}]"]
        for index in one.indices:
            numbers = ("" if value is None else f"{value:.3g}" for value in index[1:])
            key = index.key.rpartition(".")[2] if brief else index.key
            lines.append([*head, key, *numbers, _remarks(design, one)])
        if not one.indices:
            lines.append([*head, _remarks(design, one), "", "", "", "", ""])
    return page.Table(columns, lines)


def _figure(design: Sensitivity, analysis: Analysis) -> page.Figure:
    """Both measures of every key with their intervals, the most influential key at the top."""
    indices = sorted(analysis.indices, key=lambda index: index.first)
    rows, point = np.arange(len(indices)), figures.condition(analysis.axes)
    title = f"{analysis.quantity.meaning}{f' ({point})' if point else ''}"
    with drawn(f"sensitivity {title}", 1.2 + 0.34 * len(indices), title=title) as (drawing, ax):
        measures = zip(HEADINGS[design.method], (0.18, -0.18), (TRUE, ESTIMATED), strict=True)
        for k, (label, beside, colour) in enumerate(measures):
            values, widths = ([index[1 + 2 * k + j] for index in indices] for j in (0, 1))
            ax.barh(rows + beside, values, 0.34, xerr=widths, color=colour, label=label, error_kw={"elinewidth": 1.0})
        ax.set_yticks(rows, [figures.plain(index.key) for index in indices])
        unit = analysis.quantity.unit if design.method == "morris" else "share of the variance"
        ax.set(xlabel=f"{analysis.quantity.meaning} [{unit}]")
    return drawing.content


_KINDS: Final = {"compare": "comparison", "sweep": "study"}  # by the beginning of a title
_MOST_SENTENCES: Final = 6


def study_page(
    title: str, study: Study, outcomes: Sequence[Outcome], rows: Sequence[table.Row], links: Sequence[str] = ()
) -> str:
    """The page as HTML; ``links`` are the addresses of the runs' pages, empty where there is none."""
    kind, _, name = title.partition("-")
    case, seeds = outcomes[0].case, ", ".join(map(str, study.seeds))
    scenario = resolved(case)
    varied = {key for key, _ in (*case.axes, *case.drawn)}
    if kind == "compare":
        name = course_title(scenario) or name
    facts = (_KINDS.get(kind, ""), study.scenario, _facts(scenario, varied), _counted(outcomes), f"seeds {seeds}")
    file = page.Section("Study file", "offtrack sweep runs this file.", [page.Preformatted(study.to_toml())])
    design = study.draws.sensitivity
    made_on = machines([outcome.provenance for outcome in outcomes])
    return page.Page(
        title=name,
        subtitle=" · ".join(filter(None, dict.fromkeys(facts))),
        changes=changes(scenario, varied).replace("Changed:", "Changed in all runs:"),
        answer=_sensitivity_answer(design, outcomes) if design else answer(rows),
        sections=[
            *(sensitivity_sections(design, outcomes) if design else ()),
            *_sections(outcomes, rows, links),
            *_drawn(study, outcomes, rows),
            *machine_sections(made_on),
            file,
            page.software_section(versions()),
        ],
    ).html()


def _drawn(study: Study, outcomes: Sequence[Outcome], rows: Sequence[table.Row]) -> Iterator[page.Section]:
    """Spread over the drawn values, with confidence intervals."""
    if not study.draws or study.draws.sensitivity:
        return
    keys = [f"{key}: {one.kind} {', '.join(map(str, one.values))}" for key, one in study.draws.distributions.items()]
    sample = study.draws.sample
    text = f"{sample.count} draws ({sample.method}, seed {sample.seed}) for each point." if sample else ""
    if study.stop and sample:
        text = (
            f"At most {text} A point ends after the first multiple of {study.stop.batch} draws at which half the width "
            f"of the interval of each limit's probability is at most {100.0 * study.stop.half_width:g} %."
        )
    yield page.Section("Drawn values", text, [page.Items(keys)])
    if study.limits:
        text = (
            f"Share of the runs beyond the limit or not completed, with the {100 * CONFIDENCE:.0f} % interval of its "
            "probability (Clopper-Pearson)."
        )
        yield page.Section("Limits", text, [_limits(study, outcomes, rows)])
    quantities = table.shown_quantities(rows)
    yield page.Section("Spread", "Over all draws of a point.", [_spread_table(outcomes, quantities)])
    for quantity in quantities[:2]:
        text = (
            f"Mean of the draws so far, with its {100 * CONFIDENCE:.0f} % interval for independent draws; Latin "
            "hypercubes and Sobol sequences converge faster."
        )
        yield page.Section(f"Convergence: {quantity.meaning}", text, [figures.convergence(outcomes, quantity)])


def _limits(study: Study, outcomes: Sequence[Outcome], rows: Sequence[table.Row]) -> page.Table:
    columns = [page.Column("text", figures.plain(key)) for key, _ in rows[0].axes] + [page.Column("text", "limit")]
    columns += [page.Column("number", name) for name in ("beyond", "runs", "share", "from", "to")]
    lines: list[page.Row] = []
    for row in rows:
        for path, limit in study.limits.items():
            found = table.exceeding(outcomes, row.axes, path, limit)
            shares = (f"{100.0 * share:.1f} %" for share in (found.share, *found.interval()))
            values = (value for _, value in row.axes)
            lines.append([*values, f"{path} > {limit:g}", str(found.beyond), str(found.runs), *shares])
    return page.Table(columns, lines)


def _spread_table(outcomes: Sequence[Outcome], quantities: Sequence[table.Quantity]) -> page.Table:
    names = ("mean", "deviation", "5 %", "median", "95 %", "largest")
    axes = [key for key, _ in outcomes[0].case.axes]
    columns = [page.Column("text", figures.plain(key)) for key in (*axes, "quantity")] + [
        page.Column("number", name) for name in names
    ]
    lines: list[page.Row] = []
    for quantity in quantities:
        for spread in table.spreads(outcomes, quantity):
            known = spread.known
            if len(known) < 2:
                continue
            low, middle, high = np.percentile(known, (5.0, 50.0, 95.0))
            numbers = (known.mean(), known.std(ddof=1), low, middle, high, known.max())
            values = (value for _, value in spread.axes)
            shown = (table.text_of(quantity, float(number)) for number in numbers)
            lines.append([*values, f"{quantity.meaning} [{quantity.unit}]", *shown])
    return page.Table(columns, lines)


def machine_sections(made_on: Sequence[str]) -> Iterator[page.Section]:
    """A word of caution on runs of several machines."""
    if len(made_on) > 1:
        text = (
            "Equal seeds give bitwise equal runs on one machine; on others the last digits may differ. runs.csv says "
            "where each run was made."
        )
        yield page.Section("Machines", text, [page.Items(made_on)])


def finished_runs_page(outcomes: Sequence[Outcome], rows: Sequence[table.Row], links: Sequence[str] = ()) -> str:
    """The page on finished runs that are compared, as HTML; ``links`` are the addresses of their pages."""
    names = [run for outcome in outcomes for _, run in outcome.case.axes]
    facts = [f"{name}: {_facts(resolved(outcome.case))}" for name, outcome in zip(names, outcomes, strict=True)]
    title = " and ".join(names) if len(names) < 3 else f"{len(names)} runs"
    return page.Page(
        title=title,
        subtitle=f"comparison of runs · {_counted(outcomes)}",
        answer=answer(rows),
        sections=[
            *_sections(outcomes, rows, links),
            page.Section("Runs", content=[page.Items(facts)]),
            page.software_section(versions()),
        ],
    ).html()


def answer(rows: Sequence[table.Row]) -> list[str]:
    """Which run is best, in a sentence for each condition."""
    if (quantity := table.main_quantity(rows)) is None:
        return ["No run has a number to compare."]
    groups = _conditions(rows).items()
    return page.some(
        [f"{name}: {_sentence(group, quantity)}".removeprefix(": ") for name, group in groups], _MOST_SENTENCES
    )


def _conditions(rows: Sequence[table.Row]) -> dict[str, list[tuple[str, table.Row]]]:
    """The rows with the names of their laws, estimators or runs, by the values of all other keys in words."""
    keys, found = figures.varied(rows), dict[str, list[tuple[str, table.Row]]]()
    compared = [key for key in keys if key in figures.NAMED] or keys[:1]
    for row in rows:
        chosen, others = (
            figures.condition(tuple(pair for pair in row.axes if pair[0] in keys and (pair[0] in compared) == named))
            for named in (True, False)
        )
        found.setdefault(others[:1].upper() + others[1:], []).append((chosen, row))
    return found


def _sentence(named: Sequence[tuple[str, table.Row]], quantity: table.Quantity) -> str:
    """The best of some rows, the others, and those that did not complete their course."""
    best = table.best_rows([row for _, row in named], quantity)
    texts = [(name, quantity.said(value)) for name, row in named if (value := row.numbers[quantity.path]) is not None]
    ended = [f"{name or 'a run'} did not always complete the course" for name, row in named if row.completed < row.runs]
    if best:
        first = [name for name, row in named if row in best]
        others = ", ".join(f"{name} {text}" for name, text in texts if name not in first)
        side = f"{'has' if len(first) == 1 else 'have'} the {'smallest' if quantity.better == 'less' else 'largest'}"
        head = f"{' and '.join(first)} {side} {quantity.spoken}, {dict(texts)[first[0]]} ({others})"
    else:
        same = len({text for _, text in texts}) == 1
        known = texts[0][1] if same else ", ".join(f"{name} {text}" for name, text in texts)
        head = f"the {quantity.spoken} is {known}" if texts else ""
    return "; ".join(filter(None, [head, *ended])) + "."


def resolved(case: Case) -> dict[str, Any]:
    """The scenario of a run as a table; empty if its files are gone by now."""
    try:
        return case.resolved().model_dump(mode="json", exclude_none=True)
    except ValueError:
        return {}


def _facts(scenario: Mapping[str, Any], varied: Collection[str] = ()) -> str:
    """Vehicle, law and estimator of a run, without the keys that are varied."""
    return scenario_facts({key: value for key, value in scenario.items() if key not in varied})


def _counted(outcomes: Sequence[Outcome]) -> str:
    return f"{len(outcomes)} runs, {sum(outcome.completed for outcome in outcomes)} completed"


_RUNS = (
    "Every run as a line over its values, and as a dot over two of them. Red: it did not complete its course. A click "
    "opens the page that plays the run"
)


def _explored(outcomes: Sequence[Outcome], links: Sequence[str]) -> Iterator[page.Section]:
    links = list(links) or [""] * len(outcomes)
    if found := explorer(outcomes, links):
        paged = sum(map(bool, links))
        yield page.Section("Runs", f"{_RUNS}{'' if paged == len(links) else f'; {paged} runs have one'}.", [found])


def _sections(outcomes: Sequence[Outcome], rows: Sequence[table.Row], links: Sequence[str]) -> Iterator[page.Section]:
    text = (
        "One row for each combination of the varied keys, over all seeds: root mean square of RMS values, the worst of "
        "the others. Bold: better than the others under the same conditions; steer and friction have no better side."
    )
    yield page.Section("Table", text, [_table(rows)])
    shown = figures.alike(outcomes)
    if playback := played_together(shown):
        points = len({outcome.case.axes for outcome in outcomes})
        text = "Runs of the first seed, laid over each other." + (
            f" {len(shown)} of {points} combinations are shown." if len(shown) < points else ""
        )
        yield page.Section("Playback", text, [page.Player(encoded(playback))])
    yield from _explored(outcomes, links)


def _table(rows: Sequence[table.Row]) -> page.Table:
    quantities, keys = table.shown_quantities(rows), figures.varied(rows)
    columns = [page.Column("name", figures.plain(key)) for key in keys[:1]]
    columns += [page.Column("text", figures.plain(key)) for key in keys[1:]] + [page.Column("text", "completed")]
    columns += [page.Column("number", f"{q.meaning} [{q.unit}]".removesuffix(" [-]")) for q in quantities]
    groups = [[row for _, row in group] for group in _conditions(rows).values()]
    best = {q.path: [row for group in groups for row in table.best_rows(group, q)] for q in quantities}
    lines: list[page.Row] = []
    for row in rows:
        endings = f" ({', '.join(row.endings)})" if row.endings else ""
        values = [value for key, value in row.axes if key in keys]
        numbers = [
            page.Cell(table.text_of(q, row.numbers[q.path]), "best" if row in best[q.path] else "") for q in quantities
        ]
        lines.append([*values, f"{row.completed} of {row.runs}{endings}", *numbers])
    return page.Table(columns, lines)


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
