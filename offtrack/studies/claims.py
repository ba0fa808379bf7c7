"""Claims of processes on runs of a study, in a folder that machines share.

A claim is a file that only one process can create. Its owner touches it now and then. A claim whose time does not
change while another process watches it for a ``lease`` belongs to a process that has ended, and is taken over. The
clocks of the machines are not compared. If two processes make the same run after all, they save the same numbers.
"""

from __future__ import annotations

import json
import os
import platform
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

LEASE: Final = 30.0  # [s]
_BEATS: Final = 5.0  # in a lease
_ENDING: Final = ".claim"


class Claim(NamedTuple):
    """A claim on a run."""

    name: str  # of the run
    host: str
    process: int
    touched: float  # time of the last sign of life, by the file system's clock [s]


class Claims:
    """The claims in a folder, as one process sees and holds them."""

    def __init__(self, folder: Path, lease: float = LEASE) -> None:
        """Claims of a folder, which is created; a claim without a sign of life for ``lease`` [s] can be taken over."""
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._lease = folder, lease
        self._held: dict[str, str] = {}  # token by name
        self._watched: dict[str, tuple[int, float]] = {}  # by name: time of the file [ns], since when it is that [s]
        self._lock = threading.Lock()

    def take(self, name: str) -> bool:
        """Claim a run; False if another process has it."""
        path, token = self._path(name), uuid.uuid4().hex
        if not self._created(path, token) and not (self._is_abandoned(name) and self._created(path, token)):
            return False
        with self._lock:
            self._held[name] = token
        return True

    def release(self, name: str) -> None:
        """Give up a claim."""
        with self._lock:
            token = self._held.pop(name, None)
        if token is not None and _token(self._path(name)) == token:
            self._path(name).unlink(missing_ok=True)

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Touch the claims that are held until the end, and then give them up."""
        ended = threading.Event()

        def touch() -> None:
            while not ended.wait(self._lease / _BEATS):
                with self._lock:
                    held = list(self._held)
                for name in held:
                    with suppress(OSError):  # taken over, or the folder is away for a while
                        os.utime(self._path(name))

        thread = threading.Thread(target=touch, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()
            for name in list(self._held):
                self.release(name)

    def all(self) -> list[Claim]:
        """Claims of all processes."""
        found = []
        for path in sorted(self._folder.glob(f"*{_ENDING}")):
            with suppress(OSError, ValueError, KeyError, TypeError):
                owner = _owner(path)
                found.append(
                    Claim(path.name.removesuffix(_ENDING), str(owner["host"]), int(owner["pid"]), path.stat().st_mtime)
                )
        return found

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}{_ENDING}"

    def _created(self, path: Path, token: str) -> bool:
        try:
            descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        except FileExistsError:
            return False
        with open(descriptor, "w", encoding="utf-8") as file:
            json.dump({"host": platform.node(), "pid": os.getpid(), "token": token}, file)
        return True

    def _is_abandoned(self, name: str) -> bool:
        """True if a claim was removed, as it showed no sign of life for a lease."""
        path = self._path(name)
        try:
            touched, token = path.stat().st_mtime_ns, _token(path)
        except OSError:
            return True  # given up meanwhile
        seen, since = self._watched.get(name, (0, 0.0))
        if seen != touched:
            self._watched[name] = (touched, time.monotonic())
            return False
        if time.monotonic() - since < self._lease:
            return False
        del self._watched[name]
        aside = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
        try:
            path.rename(aside)
        except OSError:
            return False  # another process was faster
        is_it = _token(aside) == token
        if not is_it:  # the claim of the faster process
            with suppress(OSError):
                os.link(aside, path)
        aside.unlink(missing_ok=True)
        return is_it


def _owner(path: Path) -> dict[str, Any]:
    owner = json.loads(path.read_text(encoding="utf-8"))
    return owner if isinstance(owner, dict) else {}


def _token(path: Path) -> str:
    """The token of a claim; empty while it is being written, or is gone."""
    try:
        return str(_owner(path).get("token", ""))
    except (OSError, ValueError):
        return ""
