"""Trials of a tuning with Optuna: kept in a journal in its directory, or in a database that machines share.

Several processes share one journal, and several machines a database; finished trials survive a killed process. A trial
is a tuning set of runs. Trials with other files, another law or another offtrack are kept, but not used. In a database
every running trial shows signs of life; trials that show none are failed by the other processes, and tried again with
their parameters. Needs the extra ``tune``.
"""

import fcntl
import hashlib
import json
import logging
import os
import platform
import re
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import optuna
from optuna.exceptions import ExperimentalWarning, StorageInternalError
from optuna.storages import JournalStorage, RDBStorage, RetryHeartbeatStaleTrialCallback
from optuna.storages.journal import JournalFileBackend
from optuna.study import MaxTrialsCallback
from optuna.trial import FrozenTrial, TrialState
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from offtrack.studies.case import Outcome, identities, named_files, opened_files, watch_files
from offtrack.studies.pool import made_run
from offtrack.studies.tuning import Importances, Trial, Tuning, objective_means, with_parameters
from scenarios.extras import check_extra
from scenarios.processes import WorkerDiedError, each_in_a_worker, is_alive
from scenarios.progress import Progress, no_progress
from scenarios.results.run_directory import digest
from vehicle.foundation.user_file import FileKind, read_bytes, shown

ResultT = TypeVar("ResultT")

JOURNAL: Final = "journal.log"
BEAT: Final = 15  # between two signs of life of a trial [s]
GRACE: Final = 60  # without one, after which a trial is failed [s]
_RETRIES: Final = 2  # of a trial whose process has ended
_OPENINGS: Final = 3  # tries of processes that create the tables at the same time
_DRIVERS: Final = {  # of the kinds of databases
    "postgresql": ("postgresql+psycopg", "psycopg"),
    "sqlite": ("sqlite", "sqlite3"),
}
_FILES: Final = "files_sha256"  # of a trial: digests of files that it opened without being named
_PROCESS: Final = "process"  # of a trial: host and number of its process


def journal(directory: Path) -> JournalStorage:
    """Storage in the journal of a directory."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    path = directory / JOURNAL
    return JournalStorage(JournalFileBackend(str(path), _JournalLock(path)))


@cache
def database(url: str, *, beat: int = BEAT, grace: int = GRACE) -> RDBStorage:
    """Storage in a database; ``beat`` and ``grace`` are times of signs of life [s].

    Raises:
        ValueError: one line without the password, if it can not be used.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    logging.getLogger("sqlalchemy").setLevel(logging.CRITICAL)  # of connections that are lost
    kind = url.partition(":")[0].partition("+")[0]
    if kind not in _DRIVERS:
        expected = "postgresql://USER@HOST/DATABASE"
        raise ValueError(f"--storage {shown(hidden(url))}: expected {expected}, or sqlite:///FILE for one machine")
    scheme, module = _DRIVERS[kind]
    check_extra("cluster", f"--storage {kind}: needs", module)
    address = scheme + url[len(url.partition(":")[0]) :]
    with _refusals(url), without_warnings():
        for left in reversed(range(_OPENINGS)):
            try:
                return RDBStorage(
                    address,
                    engine_kwargs={"pool_pre_ping": True},
                    heartbeat_interval=beat,
                    grace_period=grace,
                    heartbeat_stale_trial_callback=RetryHeartbeatStaleTrialCallback(max_retry=_RETRIES),
                )
            except SQLAlchemyError:
                if not left:
                    raise
    raise AssertionError


@contextmanager
def without_warnings() -> Iterator[None]:
    """Ignore that signs of life are experimental in Optuna."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        yield


@contextmanager
def _refusals(url: str) -> Iterator[None]:
    """Turn errors of a database into one line without its password."""
    try:
        yield
    except ArgumentError:
        raise ValueError(f"--storage {shown(hidden(url))}: is no address of a database") from None
    except (SQLAlchemyError, RuntimeError, ValueError) as error:
        cause: Any = getattr(error, "orig", None) or error
        reason = " ".join(str(cause).split()).replace(_password(url) or "\0", "***")
        raise ValueError(f"--storage {shown(hidden(url))}: the database can not be used: {shown(reason)}") from None


def hidden(url: str) -> str:
    """The address without its password."""
    return re.sub(r"(://[^/@]*?):[^@]*@", r"\1:***@", url)


def _password(url: str) -> str:
    found = re.search(r"://[^/@:]*:(.*)@", url)
    return found[1] if found else ""


class _JournalLock:
    """Lock of a journal that ends with its process; what a killed process left of a line is removed."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def acquire(self) -> bool:
        """Wait for the lock."""
        self._file = self._path.open("rb+")
        fcntl.flock(self._file, fcntl.LOCK_EX)
        size = self._file.seek(0, os.SEEK_END)
        if size and (self._file.seek(-1, os.SEEK_END), self._file.read(1))[1] != b"\n":
            self._file.seek(0)
            self._file.truncate(self._file.read().rfind(b"\n") + 1)
        return True

    def release(self) -> None:
        """Release the lock."""
        self._file.close()


def in_database(tuning: Tuning, storage: str) -> Tuning:
    """The tuning with its trials in a database, under a name that is the same on all machines."""
    runs = identities(tuning.tuned_on.cases(), portable=True)
    task = (tuning.law, sorted(tuning.ranges.items(), key=lambda item: item[0]), tuning.objectives, runs)
    return replace(tuning, storage=storage, shared_name=hashlib.sha256(repr(task).encode()).hexdigest()[:20])


_AWAY: Final = (SQLAlchemyError, StorageInternalError)  # of a database that is locked or gone
PATIENCE: Final = 60.0  # with such a database [s]
_MOMENT: Final = 10.0  # a call that ends sooner has not worked in between [s]


def patiently(tuning: Tuning, call: Callable[[], ResultT]) -> ResultT:
    """Result of a call that uses the trials; while their database is locked or gone, it is made again.

    Raises:
        ValueError: one line, if the database does not come back.
    """
    waited = 0.0
    while True:
        begin = time.monotonic()
        try:
            return call()
        except Exception as error:  # Optuna trips over one of its own on the way
            cause = _of_database(error)
            if tuning.storage is None or cause is None:
                raise
            lasted = time.monotonic() - begin
            waited = waited + lasted if lasted < _MOMENT else 0.0
            if waited > PATIENCE:
                with _refusals(tuning.storage):
                    raise cause from None
            time.sleep(1.0)
            waited += 1.0


def _of_database(error: BaseException | None) -> SQLAlchemyError | None:
    """The error of a database behind another; None if there is none."""
    while error is not None and not isinstance(error, SQLAlchemyError):
        error = error.__cause__ or error.__context__
    return error


class _EnoughError(Exception):
    """There are enough trials without this one."""


def optimise(
    tuning: Tuning, directory: Path, *, trials: int, jobs: int, seed: int, progress: Progress = no_progress
) -> list[Trial]:
    """Run trials until the journal holds ``trials`` finished ones, a database at least so many; return all of those.

    A worker process that dies costs its trial, whose parameters are tried again. Only one of ``jobs`` repeats a
    search: every trial follows from those that are finished before it.

    Raises:
        ChildProcessError: one line, if a second process dies in the place of the first.
    """
    patiently(tuning, lambda: resume(tuning, directory))
    tasks = {str(k): (tuning, directory, trials, seed) for k in range(jobs)}

    def report() -> None:
        with suppress(*_AWAY):  # the workers wait for it
            progress(len(finished(tuning, directory)), trials)

    with closing(each_in_a_worker(work, tasks, jobs=jobs, meanwhile=report)) as results:
        for _, result in results:
            if isinstance(result, WorkerDiedError):
                raise ChildProcessError(f"a worker process: {result}; what is finished is kept") from result
            if isinstance(result, BaseException):
                raise result
    return patiently(tuning, lambda: finished(tuning, directory))


def work(tuning: Tuning, directory: Path, trials: int, seed: int) -> None:
    """Run trials until there are enough, in parallel with other workers; called in a worker."""
    threading.excepthook = _silent_beats

    def run_trials() -> None:
        study = _study(tuning, directory, seed)
        _fail_dead_trials(study)
        if len(finished(tuning, directory)) < trials:
            enough = MaxTrialsCallback(trials, states=(TrialState.COMPLETE,))
            with without_warnings():
                study.optimize(
                    lambda trial: _values(tuning, trial, study, trials), callbacks=[enough], catch=(_EnoughError,)
                )

    patiently(tuning, run_trials)


def _silent_beats(raised: threading.ExceptHookArgs) -> None:
    """Print the error of a thread, but not of one that shows signs of life in a database that is gone."""
    if not issubclass(raised.exc_type, _AWAY):
        threading.__excepthook__(raised)


def former(tuning: Tuning, directory: Path) -> int:
    """Number of finished trials in the journal that this tuning cannot use, as what they depend on has changed.

    Raises:
        ValueError: one line, if the journal is damaged.
    """
    path = directory / JOURNAL
    if tuning.storage is not None or not os.path.lexists(path):
        return 0
    lines = read_bytes(path, FileKind.RECORD).split(b"\n")
    try:
        for line in lines[:-1]:  # what follows the last line end was cut off by a kill
            json.loads(line)  # Optuna would notice a damaged last line only after the next one is written
        storage = journal(directory)
        names = optuna.get_all_study_names(storage)
        studies = {name: optuna.load_study(study_name=name, storage=storage) for name in names}
        trials = {name: study.get_trials(states=(TrialState.COMPLETE,)) for name, study in studies.items()}
        own = trials.pop(study_name(tuning), [])
        for trial in own:
            if lacking := sorted(tuning.ranges.keys() - trial.params.keys()):
                raise ValueError(f"trial {trial.number} has no {', '.join(lacking)}")
        return sum(map(len, trials.values())) + sum(_is_outdated(trial) for trial in own)
    except Exception as error:  # whatever a damaged line leads to in Optuna
        raise ValueError(
            f"{path} is damaged ({type(error).__name__}: {error}): remove it, or choose another --out"
        ) from error


def finished(tuning: Tuning, directory: Path) -> list[Trial]:
    """Finished trials of this tuning in the journal, in order and numbered without those that were killed."""
    complete = _study(tuning, directory, 0).get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    times = [trial.duration.total_seconds() if trial.duration else 0.0 for trial in complete]
    found = enumerate(zip(complete, times, strict=True))
    return [Trial(number=k, parameters=dict(t.params), values=tuple(t.values), seconds=s) for k, (t, s) in found]


_FEWEST: Final = 10  # trials that tell what matters


def importances(tuning: Tuning, directory: Path) -> Importances:
    """Importance of each parameter for each objective, 0 to 1; empty with too few trials, or a single parameter."""
    study = _study(tuning, directory, 0)
    if len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))) < _FEWEST or len(tuning.ranges) < 2:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it is experimental, and looks at low values
        return {
            name: optuna.importance.get_param_importances(
                study,
                evaluator=optuna.importance.PedAnovaImportanceEvaluator(),
                target=lambda trial, k=k: trial.values[k],
            )
            for k, name in enumerate(tuning.objectives)
        }


def _values(tuning: Tuning, trial: optuna.Trial, study: optuna.Study, trials: int) -> tuple[float, ...]:
    """Run the tuning set with the suggested parameters, and return the objectives.

    In a journal ``trials`` are enough, of which other workers may be making the last ones.
    """
    if tuning.storage is None:
        others = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.RUNNING))
        if sum(other.number < trial.number for other in others) >= trials:
            study.stop()
            raise _EnoughError
    parameters = {
        name: trial.suggest_float(name, range_.low, range_.high, log=range_.logarithmic)
        for name, range_ in tuning.ranges.items()
    }
    trial.set_user_attr(_PROCESS, [platform.node(), os.getpid()])
    outcomes, files = [], dict[str, str]()
    for case in with_parameters(tuning.tuned_on, parameters).cases():
        watch_files()
        scenario = case.resolved()
        outcomes.append(Outcome(case=case, numbers=made_run(scenario, case.seed).summary()))
        files |= opened_files(named_files([case.scenario, scenario.model_dump(exclude_none=True)]))
    if tuning.tuned_on.identity() != tuning.identity:
        raise ValueError("the files of the tuning runs have changed meanwhile: repeat the command")
    trial.set_user_attr(_FILES, files)
    return objective_means(tuning.objectives, outcomes)


def study_name(tuning: Tuning) -> str:
    """Name of a tuning's study in Optuna: scenario, law, and what tells it from other tunings of both."""
    return f"{Path(tuning.tuned_on.scenario).stem}-{tuning.law}-{(tuning.shared_name or tuning.identity)[:12]}"


def _is_outdated(trial: FrozenTrial) -> bool:
    return any(digest(Path(file)) != known for file, known in trial.user_attrs[_FILES].items())


def _fail_dead_trials(study: optuna.Study, *, alone: bool = False) -> None:
    """Fail trials whose process on this machine has ended, ``alone`` all, and try their parameters again."""
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        host, process = trial.user_attrs.get(_PROCESS, ("", 0))
        if alone or (host == platform.node() and not is_alive(process)):
            with suppress(ValueError, RuntimeError):  # another process was faster
                study.tell(trial.number, state=TrialState.FAIL)
                study.enqueue_trial(trial.params)


def _check_files(study: optuna.Study, tuning: Tuning) -> None:
    """Refuse to go on with trials in a database that opened a file of another content than it has here."""
    for trial in study.get_trials(deepcopy=False):
        for file, known in trial.user_attrs.get(_FILES, {}).items():
            if digest(Path(file)) not in ("", known):  # another machine may not have it
                raise ValueError(
                    f"--storage: trials of {study_name(tuning)} rest on another content of {file}: use the same "
                    "everywhere, or remove them with 'optuna delete-study'"
                )


def resume(tuning: Tuning, directory: Path) -> None:
    """Create a tuning's study, or clear it of trials with other files and of those left running.

    In a database, where other machines may be at work, those count as left that show no sign of life.

    Raises:
        ValueError: one line, if a database can not be used, or its trials rest on other files.
    """
    study = _study(tuning, directory, 0)
    if tuning.storage is not None:
        _check_files(study, tuning)
    _fail_dead_trials(study, alone=tuning.storage is None)
    if tuning.storage is not None:
        with without_warnings():
            optuna.storages.fail_stale_trials(study)
    elif any(_is_outdated(trial) for trial in study.get_trials(states=(TrialState.COMPLETE,))):
        optuna.delete_study(study_name=study_name(tuning), storage=journal(directory))
        study = _study(tuning, directory, 0)
    if set(tuning.defaults) == set(tuning.ranges):
        study.enqueue_trial(dict(tuning.defaults), skip_if_exists=True)


class _Sampler(optuna.samplers.TPESampler):  # type: ignore[misc]  # optuna has no types for mypy
    """Draws a trial from the seed, its number and the trials before it, so that a killed search goes on as it would."""

    def __init__(self, seed: int, number: int = 0) -> None:
        drawn_by = int(np.random.SeedSequence((seed, number)).generate_state(1)[0])
        super().__init__(seed=drawn_by, multivariate=True, constant_liar=True)
        self._of_all = seed

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        failed = study.get_trials(deepcopy=False, states=(TrialState.FAIL,))  # others have their parameters
        study.sampler = _Sampler(self._of_all, trial.number - sum(other.number < trial.number for other in failed))


def _study(tuning: Tuning, directory: Path, seed: int) -> optuna.Study:
    study = optuna.create_study(
        study_name=study_name(tuning),
        storage=journal(directory) if tuning.storage is None else database(tuning.storage),
        sampler=_Sampler(seed),
        directions=["minimize"] * len(tuning.objectives),
        load_if_exists=True,
    )
    if study.metric_names is None:
        with without_warnings():
            study.set_metric_names(list(tuning.objectives))
    return study
