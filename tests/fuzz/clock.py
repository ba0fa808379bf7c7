"""Time and memory that a process takes; the time that it waits for a free core is not its own."""

from __future__ import annotations

import os
import time
from pathlib import Path


class OwnTime:
    """Time since its (re)start less the time that the process's first thread waited for a core [s]."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self.restart()

    def restart(self) -> None:
        """Begin again at 0."""
        self._waited = self._before = _waiting(self._pid)
        self._begin = time.monotonic()

    def __call__(self) -> float:
        """Seconds so far; of a process that has ended those until it was last seen, and the time since."""
        self._waited = max(self._waited, _waiting(self._pid))
        return time.monotonic() - self._begin - (self._waited - self._before)


def memory(pid: int) -> float:
    """Resident memory of a process [MB]; 0 if it has ended."""
    fields = _fields(pid, "statm")
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20 if fields else 0.0


def _waiting(pid: int) -> float:
    """Time that a process has waited for a core since its start [s]."""
    fields = _fields(pid, "schedstat")
    return 1e-9 * int(fields[1]) if fields else 0.0


def _fields(pid: int, name: str) -> list[str]:
    try:
        return Path(f"/proc/{pid}/{name}").read_text(encoding="ascii").split()
    except OSError:
        return []
