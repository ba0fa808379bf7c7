"""How a run of a study was made: machine, software and time."""

from __future__ import annotations

import importlib.metadata
import platform
import time
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from vehicle.engine.compiler import engine_name

_CPU_FILE: Final = Path("/proc/cpuinfo")


class Made(NamedTuple):
    """Where and when a run was made."""

    host: str
    cpu: str
    python: str
    offtrack: str
    engine: str
    seconds: float  # of wall time
    ended: str  # UTC, ISO 8601

    @classmethod
    def of(cls, table: Any) -> Made | None:
        """As it was saved; None for a run of before it was saved, or a damaged table."""
        try:
            return cls(**table)
        except TypeError:
            return None

    @property
    def machine(self) -> str:
        """Host and processor."""
        return f"{self.host} ({self.cpu})"


def made(since: float) -> dict[str, Any]:
    """Provenance of a run that began at ``since``, on the clock `time.monotonic`."""
    return Made(
        host=platform.node(),
        cpu=_cpu(),
        python=platform.python_version(),
        offtrack=importlib.metadata.version("offtrack"),
        engine=engine_name(),
        seconds=round(time.monotonic() - since, 3),
        ended=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    )._asdict()


@cache
def _cpu() -> str:
    """Name of the processor."""
    try:
        lines = _CPU_FILE.read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, "") or platform.processor() or platform.machine()


def machines(provenance: Iterable[Made | None]) -> tuple[str, ...]:
    """Machines that made these runs, without repetition."""
    return tuple(dict.fromkeys(one.machine for one in provenance if one is not None))
