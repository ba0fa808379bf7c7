"""Tune the parameters of a trailer steering law or rover driver with Optuna; a journal file keeps every trial.

Several processes share one journal; finished trials survive a killed process. A trial is a tuning set of runs. The
result is judged on another set.
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
_FAILED: Final = 100.0  # objective of a run that did not complete: worse than that of any completed run [m, deg, …]
_POLL: Final = 0.5  # period of progress reports [s]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """A finished trial."""

    number: int
    parameters: Mapping[str, float]
    values: tuple[float, ...]


def optimise(
    tuning: Tuning, directory: Path, *, trials: int, jobs: int, seed: int, progress: Progress = no_progress
) -> list[Trial]:
    """Run trials until the journal holds at least ``trials`` finished ones, and return all of those."""
    import time

    from scenarios.studies.pool import workers

    _study(tuning, directory, seed)  # created once, before the workers open it
    with workers(jobs) as pool:
        futures = [pool.submit(work, tuning, directory, trials, seed + k) for k in range(jobs)]
        while not all(future.done() for future in futures):
            progress(len(finished(tuning, directory)), trials)
            time.sleep(_POLL)
        for future in futures:
            future.result()
    return finished(tuning, directory)


def work(tuning: Tuning, directory: Path, trials: int, seed: int) -> None:
    """Run trials until there are enough, in parallel with other workers; called in a worker."""
    from optuna.study import MaxTrialsCallback
    from optuna.trial import TrialState

    study = _study(tuning, directory, seed)
    if len(finished(tuning, directory)) < trials:
        study.optimize(
            lambda trial: _values(tuning, trial),
            callbacks=[MaxTrialsCallback(trials, states=(TrialState.COMPLETE,))],
        )


def finished(tuning: Tuning, directory: Path) -> list[Trial]:
    """Finished trials of the journal, in order."""
    from optuna.trial import TrialState

    complete = _study(tuning, directory, 0).get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return [Trial(number=t.number, parameters=dict(t.params), values=tuple(t.values)) for t in complete]


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


def _values(tuning: Tuning, trial: optuna.Trial) -> tuple[float, ...]:
    """Run the tuning set with the suggested parameters, and return the objectives."""
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
