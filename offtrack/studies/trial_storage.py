"""Storage of a tuning's trials: a journal in its directory, or a database that machines share.

In a database every running trial shows signs of life. Trials that show none are failed by the other processes, and
tried again with their parameters.
"""

from __future__ import annotations

import fcntl
import importlib.util
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from vehicle.foundation.user_file import shown

if TYPE_CHECKING:
    import optuna

JOURNAL: Final = "journal.log"
BEAT: Final = 15  # between two signs of life of a trial [s]
GRACE: Final = 60  # without one, after which a trial is failed [s]
_RETRIES: Final = 2  # of a trial whose process has ended
_OPENINGS: Final = 3  # tries of processes that create the tables at the same time
_DRIVERS: Final = {  # of the kinds of databases
    "postgresql": ("postgresql+psycopg", "psycopg"),
    "sqlite": ("sqlite", "sqlite3"),
}


def check_storage(url: str) -> None:
    """Refuse the address of another kind of database, and one that does not answer.

    Raises:
        ValueError: one line without the password.
    """
    database(url, beat=BEAT, grace=GRACE)


def journal(directory: Path) -> optuna.storages.JournalStorage:
    """Storage in the journal of a directory."""
    import optuna
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    path = directory / JOURNAL
    return optuna.storages.JournalStorage(JournalFileBackend(str(path), _JournalLock(path)))


@cache
def database(url: str, *, beat: int = BEAT, grace: int = GRACE) -> optuna.storages.RDBStorage:
    """Storage in a database; ``beat`` and ``grace`` are times of signs of life [s].

    Raises:
        ValueError: one line without the password, if it can not be used.
    """
    import optuna
    from optuna.storages import RDBStorage, RetryHeartbeatStaleTrialCallback
    from sqlalchemy.exc import SQLAlchemyError

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    kind = url.partition(":")[0].partition("+")[0]
    if kind not in _DRIVERS:
        expected = "postgresql://USER@HOST/DATABASE"
        raise ValueError(f"--storage {shown(hidden(url))}: expected {expected}, or sqlite:///FILE for one machine")
    scheme, module = _DRIVERS[kind]
    if importlib.util.find_spec(module) is None:
        raise ValueError(f"--storage {kind}: needs {module}; install it with: pip install 'offtrack[cluster]'")
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
    from optuna.exceptions import ExperimentalWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        yield


@contextmanager
def _refusals(url: str) -> Iterator[None]:
    """Turn errors of a database into one line without its password."""
    from sqlalchemy.exc import ArgumentError, SQLAlchemyError

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
