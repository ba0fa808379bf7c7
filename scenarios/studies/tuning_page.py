"""The report of a tuning: what was found, and how it does where it was not tuned."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from scenarios.report.drawing import ESTIMATED, GREY, INK, TRUE, drawn
from scenarios.report.page import html_page, section_html
from scenarios.studies.tuning import Trial, Tuning, pareto


def tuning_page(tuning: Tuning, trials: Sequence[Trial], best: Trial, judged: dict[str, tuple[float, ...]]) -> str:
    """The whole page; ``judged`` has the objectives on the judging set, of the defaults and of what was chosen."""
    heading = (
        f"<header>\n<h1>Tuning of {escape(tuning.law)}</h1>\n<p>{escape(tuning.tuned_on.scenario)} · "
        f"{len(trials)} trials of {len(tuning.tuned_on.cases())} runs each</p>\n</header>"
    )
    sections = [
        section_html("Judged on other runs", _judging(tuning), _objectives_table(tuning, judged)),
        section_html("Parameters", "Of the trials that no other one beats in every objective; chosen is the bold one.",
                     _parameters_table(tuning, pareto(trials), best)),
    ]  # fmt: skip
    if len(tuning.objectives) > 1:
        words = "Each dot is a trial; the line joins those that no other one beats."
        sections.append(section_html("Trade-off", words, front_svg(tuning, trials, best)))
    sections.append(section_html("Progress", "Best so far of the first objective.", progress_svg(tuning, trials)))
    return html_page(f"Tuning of {tuning.law} · offtrack", "\n".join([heading, *sections]), "td.best{font-weight:700}")


def front_svg(tuning: Tuning, trials: Sequence[Trial], best: Trial) -> str:
    """SVG: the first two objectives of all trials, and the Pareto front."""
    front = pareto(trials)
    with drawn("pareto", 4.2) as (drawing, axes):
        axes.plot([t.values[0] for t in trials], [t.values[1] for t in trials], ".", color=GREY, label="trials")
        if len(tuning.objectives) == 2:
            axes.step([t.values[0] for t in front], [t.values[1] for t in front], where="post", color=TRUE)
        axes.plot([t.values[0] for t in front], [t.values[1] for t in front], "o", color=TRUE, label="not beaten")
        axes.plot(*best.values[:2], "D", color=ESTIMATED, markersize=9, label="chosen")
        axes.set_xlim(0.0, 3.0 * max(t.values[0] for t in front))
        axes.set_ylim(0.0, 3.0 * max(t.values[1] for t in front))
        axes.set_xlabel(tuning.objectives[0])
        axes.set_ylabel(tuning.objectives[1])
        axes.legend()
    return drawing.svg


def progress_svg(tuning: Tuning, trials: Sequence[Trial]) -> str:
    """SVG: the first objective trial by trial, and the best of it so far."""
    values = [trial.values[0] for trial in trials]
    best = [min(values[: k + 1]) for k in range(len(values))]
    with drawn("tuning progress", 3.0) as (drawing, axes):
        axes.plot(values, ".", color=GREY, label="trial")
        axes.step(range(len(best)), best, where="post", color=INK, label="best so far")
        axes.set_ylim(0.0, 3.0 * max(best[-1], min(best[0], 10.0 * best[-1])))
        axes.set_xlabel("trial")
        axes.set_ylabel(tuning.objectives[0])
        axes.legend()
    return drawing.svg


def _judging(tuning: Tuning) -> str:
    return (
        f"Means over {len(tuning.judged_on.cases())} runs that no trial has seen: seeds "
        f"{', '.join(map(str, tuning.judged_on.seeds))}"
        + "".join(f", {escape(key)} {escape(', '.join(values))}" for key, values in tuning.judged_on.axes.items())
        + "."
    )


def _objectives_table(tuning: Tuning, judged: dict[str, tuple[float, ...]]) -> str:
    head = "<tr><th></th>" + "".join(f"<th>{escape(name)}</th>" for name in tuning.objectives) + "</tr>"
    rows = [
        f"<tr><th>{escape(name)}</th>" + "".join(f'<td class="value">{value:.4g}</td>' for value in values) + "</tr>"
        for name, values in judged.items()
    ]
    return f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'


def _parameters_table(tuning: Tuning, front: Sequence[Trial], best: Trial) -> str:
    names = [*tuning.ranges, *tuning.objectives]
    head = "<tr><th>trial</th>" + "".join(f"<th>{escape(name)}</th>" for name in names) + "</tr>"
    rows = []
    for trial in front:
        mark = "value best" if trial.number == best.number else "value"
        numbers = [*(trial.parameters[name] for name in tuning.ranges), *trial.values]
        cells = "".join(f'<td class="{mark}">{number:.4g}</td>' for number in numbers)
        rows.append(f"<tr><th>{trial.number}</th>{cells}</tr>")
    return f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'
