"""Tuning task of a steering law or rover driver: parameters, declared by a law or given, objectives, and its report.

A trial is a tuning set of runs. The result is compared with the default parameters on another set of runs.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import tomli_w

from offtrack.reports.page import Cell, Column, Figure, Page, Row, Section, Table, Verdict, software_section
from offtrack.reports.plots import ESTIMATED, GREY, INK, TRUE, drawn
from offtrack.reports.sections import changes, course_title, scenario_facts, shown_number
from offtrack.studies.case import Outcome, Settings, identities, listed, seeds_of
from offtrack.studies.study import Study, axes_of, settings_of, subject_of
from offtrack.studies.table import QUANTITIES
from scenarios.catalogue import resolve
from scenarios.options.scenario import load_any_scenario
from scenarios.results.run_directory import replaced
from scenarios.results.run_summary import versions
from vehicle.foundation.user_file import nearest
from vehicle.option import declared_options

_FAILED: Final = 100.0  # objective of a run that did not complete: worse than that of any completed run [m, deg, …]


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """Search range of a parameter."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"range {self.low:g}:{self.high:g}: expected LOW:HIGH with LOW below HIGH")

    @property
    def logarithmic(self) -> bool:
        """True if the range is positive and spans more than a decade."""
        return self.low > 0.0 and self.high / self.low > 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """A tuning task: law, parameters, objectives, tuning set and judging set."""

    law: str
    ranges: Mapping[str, Range]  # by parameter
    defaults: Mapping[str, float]  # by parameter, if the law has a default; tried first
    objectives: tuple[str, ...]  # summary metrics to minimise, as group.name
    tuned_on: Study
    judged_on: Study
    identity: str  # of the tuning set
    storage: str | None = field(default=None, repr=False)  # address of a database; may hold a password
    shared_name: str = ""  # in the database


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A finished trial."""

    number: int
    parameters: Mapping[str, float]
    values: tuple[float, ...]
    seconds: float = 0.0  # that it took


def pareto(trials: Sequence[Trial]) -> list[Trial]:
    """Pareto-optimal trials, sorted by the first objective."""
    front = [a for a in trials if not any(_beats(b.values, a.values) for b in trials)]
    return sorted(front, key=lambda trial: trial.values)


def chosen(trials: Sequence[Trial]) -> Trial:
    """The Pareto-optimal trial nearest to the best value of every objective, each scaled by its span on the front."""
    front = pareto(trials)
    best = [min(values) for values in zip(*(trial.values for trial in front), strict=True)]
    worst = [max(values) for values in zip(*(trial.values for trial in front), strict=True)]

    def distance(trial: Trial) -> float:
        spans = zip(trial.values, best, worst, strict=True)
        return math.hypot(*((value - low) / (high - low) if high > low else 0.0 for value, low, high in spans))

    return min(front, key=distance)


def with_parameters(study: Study, parameters: Mapping[str, float]) -> Study:
    """The study with these parameters of the tuned part."""
    table = subject_of(study.scenario).parameters
    settings: Settings = tuple((f"{table}.{name}", repr(value)) for name, value in parameters.items())
    return Study(scenario=study.scenario, fixed=(*study.fixed, *settings), axes=study.axes, seeds=study.seeds)


def objective_means(objectives: Sequence[str], outcomes: Sequence[Outcome]) -> tuple[float, ...]:
    """Mean of every objective over runs; a run that did not complete counts with a large penalty."""
    return tuple(sum(_number(outcome, objective) for outcome in outcomes) / len(outcomes) for objective in objectives)


def _number(outcome: Outcome, objective: str) -> float:
    value = outcome.number(objective)
    return value if outcome.completed and value is not None else _FAILED


def _beats(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return all(x <= y for x, y in zip(a, b, strict=True)) and a != b


def defaults_of(law: Callable[..., object]) -> dict[str, float]:
    """Numeric parameters of a law's class with their defaults."""
    defaults = {option.name: option.default for option in declared_options(law, or_keywords=True)}
    return {
        name: float(default)
        for name, default in defaults.items()
        if isinstance(default, int | float) and not isinstance(default, bool)
    }


def ranges_of(
    name: str, law: Callable[..., object], given: Sequence[str], decided: Collection[str] = ()
) -> dict[str, Range]:
    """Search ranges by parameter: the given ones, NAME=LOW:HIGH, or else those that the law declares.

    Parameters whose value is ``decided`` elsewhere are not searched.

    Raises:
        ValueError: one line, for an unknown parameter, or if there is no range.
    """
    options = declared_options(law, or_keywords=True)
    known = [option.name for option in options]
    ranges = {key: _range(text, key) for key, text in settings_of(given, "--range")}
    for parameter in ranges:
        if parameter not in known:
            raise ValueError(f"--range {parameter}: {name} has no such parameter{nearest(parameter, known)}")
        if parameter in decided:
            raise ValueError(f"--range {parameter}: --set or --vary gives it a value: choose one")
    ranges = ranges or {
        option.name: Range(low=option.tune[0], high=option.tune[1])
        for option in options
        if option.tune and option.name not in decided
    }
    if not ranges:
        raise ValueError(f"--controller {name}: declares no parameters to tune; use --range PARAMETER=LOW:HIGH")
    return ranges


def _range(text: str, parameter: str) -> Range:
    low, _, high = text.partition(":")
    try:
        return Range(low=float(low), high=float(high or "nan"))
    except ValueError as error:
        raise ValueError(f"--range {parameter}={text}: expected LOW:HIGH, two numbers, LOW below HIGH") from error


RunSet = tuple[Sequence[str], str]  # axes as KEY=VALUE,…, and seeds


def tuning_of(
    scenario: str,
    controller: str | None,
    objectives: str | None,
    ranges: Sequence[str],
    settings: Sequence[str],
    sets: tuple[RunSet, RunSet],
) -> Tuning:
    """The tuning task of a command's options; ``sets`` are the tuning set and the set of the comparison.

    Without a controller it is the one that the settings name, or else the usual one.

    Raises:
        ValueError: one line, for the first invalid option.
    """
    subject, given = subject_of(scenario), settings_of(settings, "--set")
    part = dict(given).get(subject.tuned)
    if part and controller not in (None, part):
        raise ValueError(f"--set {subject.tuned}={part}: --controller is {controller}: choose one")
    controller = controller or part or subject.part
    law = resolve("--controller", controller, subject.parts)
    prefix = f"{subject.parameters}."
    keys = (*dict(given), *(key for axes, _ in sets for key in axes_of(axes)))
    decided = [key.removeprefix(prefix) for key in keys if key.startswith(prefix)]
    searched = ranges_of(controller, law, ranges, decided)
    fixed = (*given, (subject.tuned, controller))
    studies = [Study(scenario=scenario, fixed=fixed, axes=axes_of(axes), seeds=seeds_of(seeds)) for axes, seeds in sets]
    identities(studies[1].cases())  # refuses invalid scenarios
    names = listed(objectives, "--objectives") if objectives else subject.objectives
    paths = tuple(quantity.path for quantity in QUANTITIES)
    for name in names:
        if name not in paths:
            raise ValueError(f"--objectives {name}: no such summary metric{nearest(name, paths)}")
    known = defaults_of(law)
    return Tuning(
        law=controller,
        ranges=searched,
        defaults={name: known[name] for name in searched if name in known},
        objectives=names,
        tuned_on=studies[0],
        judged_on=studies[1],
        identity=studies[0].identity(),
    )


def description(tuning: Tuning) -> str:
    """Text that identifies the task of a directory."""
    table: dict[str, Any] = {
        "law": tuning.law,
        "objectives": list(tuning.objectives),
        "range": {name: [range_.low, range_.high] for name, range_ in tuning.ranges.items()},
    }
    comment = "".join(f"# {line}\n" for line in tuning.tuned_on.to_toml().splitlines())
    return f"{tomli_w.dumps(table)}\n# tuned on\n{comment}"


def write_result(tuning: Tuning, trials: Sequence[Trial], best: Trial, directory: Path) -> None:
    """Write a scenario with the best parameters, ``tuned.toml``, and all trials, ``trials.csv``."""
    case = with_parameters(tuning.judged_on, best.parameters).cases()[0]
    fixed = [f"{key}={value}" for key, value in case.fixed]
    replaced(directory / "tuned.toml", load_any_scenario(case.scenario, fixed).to_toml())
    lines = [",".join(["trial", *tuning.ranges, *tuning.objectives])]
    for trial in trials:
        numbers = [*(trial.parameters[name] for name in tuning.ranges), *trial.values]
        lines.append(",".join([str(trial.number), *map(repr, numbers)]))
    replaced(directory / "trials.csv", "\n".join(lines) + "\n")


Importances = Mapping[str, Mapping[str, float]]  # of each parameter, by the objective; empty: not known


def tuning_page(
    tuning: Tuning,
    trials: Sequence[Trial],
    best: Trial,
    compared: Mapping[str, tuple[float, ...]],
    importances: Importances,
) -> str:
    """The page as HTML; ``compared``: the objectives on other runs, for the default and the chosen parameters."""
    sections = [
        Section("Parameters", "Trials that no other trial beats in every objective. Bold: the chosen one.",
                [_parameters_table(tuning, pareto(trials), best)]),
    ]  # fmt: skip
    if importances:
        sections.append(Section("Importance of the parameters", _IMPORTANCE, [_importance_table(tuning, importances)]))
    if len(tuning.objectives) > 1:
        text = "Each dot is a trial; the line joins the trials that no other trial beats in every objective."
        sections.append(Section("Trade-off", text, [_front(tuning, trials, best)]))
    sections.append(Section("Progress", "The first objective, trial by trial.", [_progress(tuning, trials)]))
    runs = len(tuning.tuned_on.cases())
    took = sum(trial.seconds for trial in trials)
    total = f"{len(trials)} trials of {runs} run{'s' if runs > 1 else ''}" + (f" in {took:.0f} s" if took else "")
    fixed = [f"{key}={value}" for key, value in tuning.judged_on.fixed]
    scenario = load_any_scenario(tuning.judged_on.scenario, fixed).model_dump(mode="json", exclude_none=True)
    defaults, tuned = compared.values()
    better = _beats(tuned, defaults)  # in an objective on other runs, and worse in none
    return Page(
        title=f"{tuning.law} on {course_title(scenario)}",
        subtitle=f"tuning · {total} · {scenario_facts(scenario)}",
        changes=changes(scenario).replace("Changed:", "Changed in all runs:"),
        verdict=Verdict("better than the defaults" if better else "nothing better than the defaults", better),
        answer=_answer(tuning, compared),
        sections=[*sections, software_section(versions())],
    ).html()


def _answer(tuning: Tuning, compared: Mapping[str, tuple[float, ...]]) -> list[str]:
    """Each objective with the chosen parameters and with the defaults, in a sentence."""
    defaults, tuned = compared.values()
    if tuned == defaults:
        return ["Nothing better than the defaults was found; they are kept."]
    return [
        f"{number.label}: {number.said(new)} with the tuned parameters, {number.said(old)} with the defaults"
        f"{f' ({100.0 * (new / old - 1.0):+.0f} %)' if old else ''}, on runs that no trial has used."
        for number, old, new in zip(map(shown_number, tuning.objectives), defaults, tuned, strict=True)
    ]


def _titled(objective: str) -> str:
    """Label of an objective with its own unit."""
    number = shown_number(objective)
    return f"{number.label} [{number.own_unit}]".removesuffix(" [-]")


_IMPORTANCE: Final = (
    "Share of each parameter in what makes trials good, by PED-ANOVA over all trials, for each objective."
)


def _importance_table(tuning: Tuning, importances: Importances) -> Table:
    columns = [Column("name", "parameter"), *(Column("text", shown_number(one).label) for one in tuning.objectives)]
    order = sorted(tuning.ranges, key=lambda name: -importances[tuning.objectives[0]][name])
    shares = {name: [importances[one][name] for one in tuning.objectives] for name in order}
    rows: list[Row] = [[name, *(Cell(f"{100 * s:.0f} % ", share=s) for s in of_all)] for name, of_all in shares.items()]
    return Table(columns, rows)


def _parameters_table(tuning: Tuning, front: Sequence[Trial], best: Trial) -> Table:
    names = [*tuning.ranges, *map(_titled, tuning.objectives)]
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
        ax.set(xlabel=_titled(tuning.objectives[0]), ylabel=_titled(tuning.objectives[1]))
    return drawing.content


def _progress(tuning: Tuning, trials: Sequence[Trial]) -> Figure:
    """The first objective trial by trial, and its best value so far."""
    values = [trial.values[0] for trial in trials]
    best = [min(values[: k + 1]) for k in range(len(values))]
    with drawn("tuning progress", 3.0) as (drawing, ax):
        ax.plot(values, ".", color=GREY, label="trial")
        ax.step(range(len(best)), best, where="post", color=INK, label="best so far")
        ax.set_ylim(0.0, 3.0 * max(best[-1], min(best[0], 10.0 * best[-1])) or 1.0)
        ax.set(xlabel="trial", ylabel=_titled(tuning.objectives[0]))
    return drawing.content
