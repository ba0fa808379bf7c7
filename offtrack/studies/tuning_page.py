"""The report of a tuning: the parameters chosen, and their results on runs that they were not tuned on."""

from collections.abc import Mapping, Sequence

from offtrack.reports.page import Cell, Column, Figure, Page, Row, Section, Table, software_section
from offtrack.reports.plots import ESTIMATED, GREY, INK, TRUE, drawn
from offtrack.studies.tuning import Trial, Tuning, pareto
from scenarios.results.run_summary import versions


def tuning_page(tuning: Tuning, trials: Sequence[Trial], best: Trial, compared: Mapping[str, tuple[float, ...]]) -> str:
    """The page as HTML; ``compared``: the objectives on other runs, for the default and the chosen parameters."""
    sections = [
        Section("Result on other runs", _judging_text(tuning), [_objectives_table(tuning, compared)]),
        Section("Parameters", "Trials that no other trial beats in every objective. Bold: the chosen one.",
                [_parameters_table(tuning, pareto(trials), best)]),
    ]  # fmt: skip
    if len(tuning.objectives) > 1:
        text = "Each dot is a trial; the line joins the trials that no other trial beats in every objective."
        sections.append(Section("Trade-off", text, [_front(tuning, trials, best)]))
    sections.append(Section("Progress", "The first objective, trial by trial.", [_progress(tuning, trials)]))
    return Page(
        title=f"Tuning of {tuning.law}",
        heading=f"Tuning of {tuning.law}",
        subtitle=f"{tuning.tuned_on.scenario} · {len(trials)} trials · runs per trial: {len(tuning.tuned_on.cases())}",
        sections=[*sections, software_section(versions())],
    ).html()


def _judging_text(tuning: Tuning) -> str:
    study = tuning.judged_on
    axes = "".join(f" · {key} {', '.join(values)}" for key, values in study.axes.items())
    seeds = ", ".join(map(str, study.seeds))
    return f"Means over runs that no trial has used. Number of runs: {len(study.cases())} · seeds {seeds}{axes}."


def _objectives_table(tuning: Tuning, compared: Mapping[str, tuple[float, ...]]) -> Table:
    columns = [Column("name"), *(Column("number", name) for name in tuning.objectives)]
    return Table(columns, [[name, *(f"{value:.4g}" for value in values)] for name, values in compared.items()])


def _parameters_table(tuning: Tuning, front: Sequence[Trial], best: Trial) -> Table:
    names = [*tuning.ranges, *tuning.objectives]
    rows: list[Row] = []
    for trial in front:
        numbers = [*(trial.parameters[name] for name in tuning.ranges), *trial.values]
        cells = [Cell(f"{number:.4g}", "best" if trial.number == best.number else "") for number in numbers]
        rows.append([str(trial.number), *cells])
    return Table([Column("name", "trial"), *(Column("number", name) for name in names)], rows)


def _front(tuning: Tuning, trials: Sequence[Trial], best: Trial) -> Figure:
    """The first two objectives of all trials, and the Pareto front."""
    front = pareto(trials)
    with drawn("pareto", 4.2) as (drawing, ax):
        ax.plot([t.values[0] for t in trials], [t.values[1] for t in trials], ".", color=GREY, label="trials")
        if len(tuning.objectives) == 2:
            ax.step([t.values[0] for t in front], [t.values[1] for t in front], where="post", color=TRUE)
        ax.plot([t.values[0] for t in front], [t.values[1] for t in front], "o", color=TRUE, label="not beaten")
        ax.plot(*best.values[:2], "D", color=ESTIMATED, markersize=9, label="chosen")
        ax.set_xlim(0.0, 3.0 * max(t.values[0] for t in front) or 1.0)
        ax.set_ylim(0.0, 3.0 * max(t.values[1] for t in front) or 1.0)
        ax.set(xlabel=tuning.objectives[0], ylabel=tuning.objectives[1])
    return drawing.content


def _progress(tuning: Tuning, trials: Sequence[Trial]) -> Figure:
    """The first objective trial by trial, and its best value so far."""
    values = [trial.values[0] for trial in trials]
    best = [min(values[: k + 1]) for k in range(len(values))]
    with drawn("tuning progress", 3.0) as (drawing, ax):
        ax.plot(values, ".", color=GREY, label="trial")
        ax.step(range(len(best)), best, where="post", color=INK, label="best so far")
        ax.set_ylim(0.0, 3.0 * max(best[-1], min(best[0], 10.0 * best[-1])) or 1.0)
        ax.set(xlabel="trial", ylabel=tuning.objectives[0])
    return drawing.content
