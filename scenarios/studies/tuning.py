"""Tuning of a trailer steering law's parameters on a set of runs, by Optuna; a journal file keeps every trial.

Several processes work on one journal, and whoever is killed leaves the finished trials to the next one. The runs that
a trial is made of are a tuning set; what was found is judged on others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from scenarios.progress import Progress, no_progress
from scenarios.studies.case import Outcome, Settings
from scenarios.studies.study import Study
from scenarios.studies.subject import subject_of

if TYPE_CHECKING:
    import optuna

JOURNAL: Final = "journal.log"
_NAME: Final = "tuning"
_FAILED: Final = 100.0  # of every objective where a run did not complete: worse than anything that did [m, deg, …]
_POLL: Final = 0.5  # [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """Where a parameter is looked for."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"range {self.low:g}:{self.high:g}: expected LOW:HIGH with LOW below HIGH")

    @property
    def logarithmic(self) -> bool:
        """Whether it spans more than a decade on one side of zero."""
        return self.low > 0.0 and self.high / self.low > 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """What is tuned, on what, and for what."""

    law: str
    ranges: Mapping[str, Range]  # by parameter
    defaults: Mapping[str, float]  # where the law has a default: tried first
    objectives: tuple[str, ...]  # group.name of the summary, each to be small
    tuned_on: Study
    judged_on: Study


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A finished trial."""

    number: int
    parameters: Mapping[str, float]
    values: tuple[float, ...]


def optimise(
    tuning: Tuning, directory: Path, *, trials: int, jobs: int, seed: int, progress: Progress = no_progress
) -> list[Trial]:
    """Run trials until the journal holds at least ``trials`` finished ones; all finished trials."""
    import time

    from scenarios.studies.pool import workers

    _study(tuning, directory, seed)  # one process makes it, the others find it
    with workers(jobs) as pool:
        futures = [pool.submit(work, tuning, directory, trials, seed + k) for k in range(jobs)]
        while not all(future.done() for future in futures):
            progress(len(finished(tuning, directory)), trials)
            time.sleep(_POLL)
        for future in futures:
            future.result()
    return finished(tuning, directory)


def work(tuning: Tuning, directory: Path, trials: int, seed: int) -> None:
    """Makes trials until there are enough of them, with others at the same time; called in a worker."""
    from optuna.study import MaxTrialsCallback
    from optuna.trial import TrialState

    study = _study(tuning, directory, seed)
    if len(finished(tuning, directory)) < trials:
        study.optimize(
            lambda trial: _values(tuning, trial),
            callbacks=[MaxTrialsCallback(trials, states=(TrialState.COMPLETE,))],
        )


def finished(tuning: Tuning, directory: Path) -> list[Trial]:
    """The finished trials in the journal, in their order."""
    from optuna.trial import TrialState

    complete = _study(tuning, directory, 0).get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return [Trial(number=t.number, parameters=dict(t.params), values=tuple(t.values)) for t in complete]


def pareto(trials: Sequence[Trial]) -> list[Trial]:
    """The trials that no other one beats in every objective, by the first objective."""
    front = [a for a in trials if not any(_beats(b.values, a.values) for b in trials)]
    return sorted(front, key=lambda trial: trial.values)


def chosen(trials: Sequence[Trial]) -> Trial:
    """Of the trials that no other beats, the one that lies nearest to the best of every objective.

    Distances are measured in the spans of the unbeaten trials, so that units do not matter.
    """
    front = pareto(trials)
    best = [min(values) for values in zip(*(trial.values for trial in front), strict=True)]
    worst = [max(values) for values in zip(*(trial.values for trial in front), strict=True)]

    def distance(trial: Trial) -> float:
        spans = zip(trial.values, best, worst, strict=True)
        return math.hypot(*((value - low) / (high - low) if high > low else 0.0 for value, low, high in spans))

    return min(front, key=distance)


def with_parameters(study: Study, parameters: Mapping[str, float]) -> Study:
    """The study with parameters of the tuned part set."""
    table = subject_of(study.scenario).parameters
    chosen: Settings = tuple((f"{table}.{name}", repr(value)) for name, value in parameters.items())
    return Study(scenario=study.scenario, fixed=(*study.fixed, *chosen), axes=study.axes, seeds=study.seeds)


def objective_means(objectives: Sequence[str], outcomes: Sequence[Outcome]) -> tuple[float, ...]:
    """Every objective's mean over runs; one that did not complete counts as very bad."""
    return tuple(sum(_number(outcome, objective) for outcome in outcomes) / len(outcomes) for objective in objectives)


def _number(outcome: Outcome, objective: str) -> float:
    value = outcome.number(objective)
    return value if outcome.completed and value is not None else _FAILED


def _values(tuning: Tuning, trial: optuna.Trial) -> tuple[float, ...]:
    """A trial: the runs of the tuning set with the parameters that it suggests."""
    from scenarios.loop.run import run_any
    from scenarios.options.scenario import load_any_scenario
    from scenarios.results.summary import summary

    parameters = {
        name: trial.suggest_float(name, range_.low, range_.high, log=range_.logarithmic)
        for name, range_ in tuning.ranges.items()
    }
    outcomes = []
    for case in with_parameters(tuning.tuned_on, parameters).cases():
        result = run_any(load_any_scenario(case.scenario, case.settings), case.seed)
        outcomes.append(Outcome(case=case, numbers=summary(result)))
    return objective_means(tuning.objectives, outcomes)


def _study(tuning: Tuning, directory: Path, seed: int) -> Any:
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    directory.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        study_name=_NAME,
        storage=JournalStorage(JournalFileBackend(str(directory / JOURNAL))),
        sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True),
        directions=["minimize"] * len(tuning.objectives),
        load_if_exists=True,
    )
    if not study.trials and set(tuning.defaults) == set(tuning.ranges):
        study.enqueue_trial(dict(tuning.defaults))
    return study


def _beats(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return all(x <= y for x, y in zip(a, b, strict=True)) and a != b
