"""Tune parameters, declared by a law or given, of a steering law or rover driver with Optuna.

Several processes share one journal, and several machines a database; finished trials survive a killed process. A trial
is a tuning set of runs. The result is judged on another set. Trials with other files, another law or another offtrack
are kept, but not used.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from offtrack.studies.case import Outcome, Settings, identities
from offtrack.studies.identity import named_files, opened_files, watch_files
from offtrack.studies.study import Study, settings_of, subject_of
from offtrack.studies.trial_storage import JOURNAL, database, journal, without_warnings
from scenarios.processes import WorkerDiedError, each_in_a_worker, is_alive
from scenarios.progress import Progress, no_progress
from scenarios.results.atomic_files import digest
from vehicle.foundation.parameter_file import nearest
from vehicle.foundation.user_file import FileKind, read_bytes
from vehicle.option import declared_options

if TYPE_CHECKING:
    import optuna
    from optuna.trial import FrozenTrial


_FILES: Final = "files_sha256"  # of a trial: digests of files that it opened without being named
_FAILED: Final = 100.0  # objective of a run that did not complete: worse than that of any completed run [m, deg, …]
_PROCESS: Final = "process"  # of a trial: host and number of its process


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


def in_database(tuning: Tuning, storage: str) -> Tuning:
    """The tuning with its trials in a database, under a name that is the same on all machines."""
    runs = identities(tuning.tuned_on.cases(), portable=True)
    task = (tuning.law, sorted(tuning.ranges.items(), key=lambda item: item[0]), tuning.objectives, runs)
    return replace(tuning, storage=storage, shared_name=hashlib.sha256(repr(task).encode()).hexdigest()[:20])


def optimise(
    tuning: Tuning, directory: Path, *, trials: int, jobs: int, seed: int, progress: Progress = no_progress
) -> list[Trial]:
    """Run trials until the journal or database holds at least ``trials`` finished ones, and return all of those.

    A worker process that dies costs its trial, whose parameters are tried again.

    Raises:
        ChildProcessError: one line, if a second process dies in the place of the first.
    """
    resume(tuning, directory)
    ended = list[str]()

    def tasks() -> Iterator[tuple[str, Sequence[object]] | None]:
        for k in range(jobs):
            yield str(k), (tuning, directory, trials, seed + k)
        while len(ended) < jobs:
            progress(len(finished(tuning, directory)), trials)
            yield None

    with closing(each_in_a_worker(work, tasks(), jobs=jobs + 1)) as results:  # one is never taken: tasks are asked for
        for key, result in results:
            ended.append(key)
            if isinstance(result, WorkerDiedError):
                raise ChildProcessError(f"a worker process: {result}; what is finished is kept") from result
            if isinstance(result, BaseException):
                raise result
    return finished(tuning, directory)


def work(tuning: Tuning, directory: Path, trials: int, seed: int) -> None:
    """Run trials until there are enough, in parallel with other workers; called in a worker."""
    from optuna.study import MaxTrialsCallback
    from optuna.trial import TrialState

    study = _study(tuning, directory, seed)
    _fail_dead_trials(study)
    if len(finished(tuning, directory)) < trials:
        enough = MaxTrialsCallback(trials, states=(TrialState.COMPLETE,))
        with without_warnings():
            study.optimize(lambda trial: _values(tuning, trial), callbacks=[enough])


def former(tuning: Tuning, directory: Path) -> int:
    """Number of finished trials in the journal that this tuning cannot use, as what they depend on has changed.

    Raises:
        ValueError: one line, if the journal is damaged.
    """
    from optuna.trial import TrialState

    path = directory / JOURNAL
    if tuning.storage is not None or not os.path.lexists(path):
        return 0
    lines = read_bytes(path, FileKind.RECORD).split(b"\n")
    try:
        for line in lines[:-1]:  # what follows the last line end was cut off by a kill
            json.loads(line)  # Optuna would notice a damaged last line only after the next one is written
        trials = {study.study_name: study.get_trials(states=(TrialState.COMPLETE,)) for study in _studies(directory)}
        own = trials.pop(_name(tuning), [])
        return sum(map(len, trials.values())) + sum(_is_outdated(trial) for trial in own)
    except Exception as error:  # whatever a damaged line leads to in Optuna
        raise ValueError(
            f"{path} is damaged ({type(error).__name__}: {error}): remove it, or choose another --out"
        ) from error


def finished(tuning: Tuning, directory: Path) -> list[Trial]:
    """Finished trials of this tuning in the journal, in order."""
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
    from scenarios.loop.runner import run

    parameters = {
        name: trial.suggest_float(name, range_.low, range_.high, log=range_.logarithmic)
        for name, range_ in tuning.ranges.items()
    }
    trial.set_user_attr(_PROCESS, [platform.node(), os.getpid()])
    outcomes, files = [], dict[str, str]()
    for case in with_parameters(tuning.tuned_on, parameters).cases():
        watch_files()
        scenario = case.resolved()
        outcomes.append(Outcome(case=case, numbers=run(scenario, case.seed).summary()))
        files |= opened_files(named_files([case.scenario, scenario.model_dump(exclude_none=True)]))
    if tuning.tuned_on.identity() != tuning.identity:
        raise ValueError("the files of the tuning runs have changed meanwhile: repeat the command")
    trial.set_user_attr(_FILES, files)
    return objective_means(tuning.objectives, outcomes)


def _name(tuning: Tuning) -> str:
    """Name of a tuning's study in Optuna."""
    return f"tuning-{tuning.shared_name or tuning.identity}"


def _is_outdated(trial: FrozenTrial) -> bool:
    return any(digest(Path(file)) != known for file, known in trial.user_attrs[_FILES].items())


def _fail_dead_trials(study: optuna.Study) -> None:
    """Fail trials whose process on this machine has ended, and try their parameters again."""
    from optuna.trial import TrialState

    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        host, process = trial.user_attrs.get(_PROCESS, ("", 0))
        if host == platform.node() and not is_alive(process):
            with suppress(ValueError, RuntimeError):  # another process was faster
                study.tell(trial.number, state=TrialState.FAIL)
                study.enqueue_trial(trial.params)


def _check_files(study: optuna.Study, tuning: Tuning) -> None:
    """Refuse to go on with trials in a database that opened a file of another content than it has here.

    Raises:
        ValueError: one line.
    """
    for trial in study.get_trials(deepcopy=False):
        for file, known in trial.user_attrs.get(_FILES, {}).items():
            if digest(Path(file)) not in ("", known):  # another machine may not have it
                raise ValueError(
                    f"--storage: trials of {_name(tuning)} rest on another content of {file}: use the same "
                    "everywhere, or remove them with 'optuna delete-study'"
                )


def resume(tuning: Tuning, directory: Path) -> None:
    """Create a tuning's study, or clear it of trials with other files and of those left running.

    In a database, where other machines may be at work, those count as left that show no sign of life.

    Raises:
        ValueError: one line, if a database can not be used, or its trials rest on other files.
    """
    import optuna
    from optuna.trial import TrialState

    study = _study(tuning, directory, 0)
    if tuning.storage is not None:
        _check_files(study, tuning)
        _fail_dead_trials(study)
        with without_warnings():
            optuna.storages.fail_stale_trials(study)
        if set(tuning.defaults) == set(tuning.ranges):
            study.enqueue_trial(dict(tuning.defaults), skip_if_exists=True)
        return
    if any(_is_outdated(trial) for trial in study.get_trials(states=(TrialState.COMPLETE,))):
        optuna.delete_study(study_name=_name(tuning), storage=journal(directory))
        study = _study(tuning, directory, 0)
    for trial in study.get_trials(states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)
        study.enqueue_trial(trial.params)
    if set(tuning.defaults) == set(tuning.ranges):
        study.enqueue_trial(dict(tuning.defaults), skip_if_exists=True)


def _study(tuning: Tuning, directory: Path, seed: int) -> optuna.Study:
    import optuna

    return optuna.create_study(
        study_name=_name(tuning),
        storage=journal(directory) if tuning.storage is None else database(tuning.storage),
        sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True),
        directions=["minimize"] * len(tuning.objectives),
        load_if_exists=True,
    )


def _studies(directory: Path) -> list[optuna.Study]:
    import optuna

    storage = journal(directory)
    return [optuna.load_study(study_name=name, storage=storage) for name in optuna.get_all_study_names(storage)]


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


def ranges_of(name: str, law: Callable[..., object], given: Sequence[str]) -> dict[str, Range]:
    """Search ranges by parameter: the given ones, NAME=LOW:HIGH, or else those that the law declares.

    Raises:
        ValueError: one line, for an unknown parameter, or if there is no range.
    """
    options = declared_options(law, or_keywords=True)
    known = [option.name for option in options]
    ranges = {key: _range(text, key) for key, text in settings_of(given, "--range")}
    for parameter in ranges:
        if parameter not in known:
            raise ValueError(f"--range {parameter}: {name} has no such parameter{nearest(parameter, known)}")
    ranges = ranges or {
        option.name: Range(low=option.tune[0], high=option.tune[1]) for option in options if option.tune
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
