"""Runs: make one, load one, look at its numbers and signals."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from offtrack.settings import load
from offtrack.tables import pandas
from scenarios.loop.run import run_any
from scenarios.report.numbers import groups
from scenarios.report.writer import write_run
from scenarios.results.log import Log, read_log
from scenarios.results.rover import RoverResult
from scenarios.results.run_result import RunResult
from scenarios.results.summary import summary
from vehicle.frames import FloatArray
from vehicle.user_file import FileKind, read_text

if TYPE_CHECKING:
    from pandas import DataFrame

_FILES = ("summary.json", "signals.parquet", "scenario.toml")


class Run:
    """A finished run: its numbers and signals.

    Attributes:
        summary: the content of ``summary.json``.
        log: every signal over time; ``run["off_tracking_true"]`` is one of them.
        directory: where it was written or read; None if it is in memory alone.
    """

    def __init__(
        self, summary: Mapping[str, Any], log: Log, directory: Path | None, result: RunResult | RoverResult | None
    ) -> None:
        """Use `run` or `load_run`."""
        self.summary, self.log, self.directory = summary, log, directory
        self._result = result

    @property
    def outcome(self) -> str:
        """How it ended; "completed" if all went well."""
        return str(self.summary["outcome"])

    def __getitem__(self, signal: str) -> FloatArray:
        """Values of a signal over time, in SI units (n,).

        Raises:
            KeyError: if there is no such signal.
        """
        return self.log[signal]

    def save(self, directory: str | os.PathLike[str], *, video: bool = False) -> Path:
        """Write a run directory, as ``offtrack run --out`` does; return it.

        Raises:
            ValueError: one line, if the directory is not empty, or the run was loaded from one.
        """
        if self._result is None:
            raise ValueError(f"this run was loaded from {self.directory}: copy that directory")
        self.directory = write_run(self._result, Path(directory), video=video)
        return self.directory

    def to_pandas(self) -> DataFrame:
        """Signals as a table over time [s], with ``attrs["units"]`` and ``attrs["descriptions"]`` by signal.

        Raises:
            ImportError: one line, if pandas is not installed.
        """
        table = pandas().DataFrame({signal.name: self.log[signal.name] for signal in self.log.signals})
        table.index = pandas().Index(self.log["time"], name="time")
        table.attrs["units"] = {signal.name: signal.unit for signal in self.log.signals}
        table.attrs["descriptions"] = {signal.name: signal.description for signal in self.log.signals}
        return table

    def __repr__(self) -> str:
        return f"<run of {self.summary['scenario']}, seed {self.summary['seed']}: {self.outcome}>"

    def _repr_html_(self) -> str:
        """Numbers of the run as a table, for notebooks."""
        rows = [
            f"<tr><td>{escape(shown.label)}</td><td style='text-align:right'>{escape(shown.text(value))}</td></tr>"
            for name, group in groups().items()
            for key, shown in group.numbers.items()
            if isinstance(value := _number(self.summary.get(name), key), int | float)
        ]
        title = f"{self.summary['scenario']}, seed {self.summary['seed']}: {self.outcome}"
        warnings = "".join(f"<p>Warning: {escape(str(line))}</p>" for line in self.summary.get("warnings", ()))
        return f"<h4>{escape(title)}</h4><table>{''.join(rows)}</table>{warnings}"


def run(
    scenario: str | os.PathLike[str],
    *,
    seed: int = 1,
    settings: Mapping[str, Any] | None = None,
    keep_frames: bool = False,
    **keys: Any,
) -> Run:
    """Run a scenario in the closed loop.

    Args:
        scenario: name of a shipped scenario, or a TOML file.
        seed: decides world and noise; the same seed on the same machine gives bitwise the same signals.
        settings: values by dotted keys of the scenario: ``{"surface.friction": 0.3}``; ``offtrack keys`` lists them.
        keep_frames: keep pictures of the camera for the report and the video of `Run.save`.
        **keys: the same as keyword arguments, with two underscores for a dot: ``surface__friction=0.3``.

    Raises:
        TypeError: one line, if an argument is of another type.
        ValueError: one line that names key, value and limit.
    """
    chosen = load(scenario, settings, keys)
    result = run_any(chosen, checked_seed(seed), keep_frames=keep_frames)
    return Run(summary(result), result.log, None, result)


def checked_seed(seed: object) -> int:
    """The seed.

    Raises:
        TypeError: one line, if it is no whole number.
        ValueError: one line, if it is negative.
    """
    if isinstance(seed, bool) or not hasattr(seed, "__index__"):
        raise TypeError(f"seed must be a whole number, not {type(seed).__name__}")
    if int(seed) < 0:
        raise ValueError(f"seed = {int(seed)} must not be negative")
    return int(seed)


def load_run(directory: str | os.PathLike[str]) -> Run:
    """Load a run directory.

    Raises:
        TypeError: one line, if the argument is no path.
        ValueError: one line, if it is no run directory or a file in it is broken.
    """
    if not isinstance(directory, str | os.PathLike):
        raise TypeError(f"directory must be a path, not {type(directory).__name__}")
    folder = Path(directory)
    missing = [name for name in _FILES if not (folder / name).is_file()]
    if missing:
        raise ValueError(f"{folder} is no run directory: {', '.join(missing)} missing")
    numbers = _summary(folder / "summary.json")
    return Run(numbers, read_log(folder / "signals.parquet"), folder, None)


def _summary(file: Path) -> dict[str, Any]:
    try:
        numbers = json.loads(read_text(file, FileKind.RECORD))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
    if not isinstance(numbers, dict) or not {"outcome", "scenario", "seed"} <= numbers.keys():
        raise ValueError(f"{file} is no summary of a run")
    return numbers


def _number(group: object, key: str) -> object:
    return group.get(key) if isinstance(group, Mapping) else None
