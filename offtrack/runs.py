"""Runs: make one, at once or step by step, load one, look at its numbers and signals; keys are keyword arguments."""

from __future__ import annotations

import importlib
import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from html import escape
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from estimators.estimates import OffTracking, SlipAngle
from offtrack.reports.run_files import read_summary, write_run
from offtrack.reports.sections import groups
from scenarios.loop.channel import InLine
from scenarios.loop.runner import KINDS
from scenarios.loop.runner import run as run_scenario
from scenarios.options.scenario import AnyScenario, load_any_scenario
from scenarios.progress import Progress, no_progress
from scenarios.results.log import Log, Signal, read_log
from scenarios.results.run_inputs import run_inputs
from scenarios.results.run_summary import Result, number_at
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.rover.truth import RoverTruth

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame


def load(scenario: str | os.PathLike[str], settings: Mapping[str, Any] | None, keys: Mapping[str, Any]) -> AnyScenario:
    """Load a scenario by name or file, with keys changed.

    Args:
        scenario: name of a shipped scenario, or a TOML file.
        settings: values by dotted keys, for example ``{"surface.friction": 0.3}``.
        keys: values by keys as Python names; two underscores stand for a dot: ``surface__friction=0.3``.

    Raises:
        TypeError: one line, if an argument is of another type.
        ValueError: one line that names key, value and limit.
    """
    if not isinstance(scenario, str | os.PathLike):
        raise TypeError(f"scenario must be a name or a TOML file, not {type(scenario).__name__}")
    if settings is not None and not isinstance(settings, Mapping):
        raise TypeError(f"settings must be a table of values by dotted keys, not {type(settings).__name__}")
    words = {key.replace("__", "."): value for key, value in keys.items()}
    if twice := set(words) & set(settings or {}):
        raise ValueError(f"{min(twice)} is in settings and a keyword argument: choose one")
    values = {**(settings or {}), **words}
    return load_any_scenario(os.fspath(scenario), [f"{key}={text_of(key, value)}" for key, value in values.items()])


def text_of(key: str, value: object) -> str:
    """A value as ``--set`` takes it.

    Raises:
        TypeError: one line, if no key has values of its type.
    """
    if isinstance(value, str | Path):
        return str(value)
    if isinstance(value, bool | int | float):
        return tomli_w.dumps({"value": value}).removeprefix("value = ").strip()
    if hasattr(value, "item") and getattr(value, "ndim", 1) == 0:  # a scalar of NumPy
        return text_of(key, value.item())
    if isinstance(value, list | tuple):
        return f"[{', '.join(_in_list(key, item) for item in value)}]"
    raise TypeError(f"{key} must be a text, a number, true or false, or a list of them, not {type(value).__name__}")


def _in_list(key: str, value: object) -> str:
    return json.dumps(str(value), ensure_ascii=False) if isinstance(value, str | Path) else text_of(key, value)


def pandas() -> Any:
    """The module pandas.

    Raises:
        ImportError: one line, if it is not installed.
    """
    try:
        return importlib.import_module("pandas")
    except ImportError:
        raise ImportError("to_pandas needs pandas: pip install 'offtrack[pandas]'") from None


class Values(np.ndarray[tuple[int], np.dtype[np.float64]]):
    """Values of a signal over time, an array with ``unit`` and ``description``; what is computed of it has neither."""

    signal: Signal | None = None

    @property
    def unit(self) -> str:
        """The signal's unit."""
        return self.signal.unit if self.signal else ""

    @property
    def description(self) -> str:
        """What the signal is."""
        return self.signal.description if self.signal else ""


@contextmanager
def shown_progress(title: str, *, shown: bool | None) -> Iterator[Progress]:
    """Progress callback that draws a bar; None: in a terminal or a notebook."""
    if not (sys.stderr.isatty() or "ipykernel" in sys.modules if shown is None else shown):
        yield no_progress
        return
    from rich.console import Console
    from rich.progress import Progress as Display

    with Display(console=Console(stderr=True)) as display:
        task = display.add_task(title, total=None)
        yield lambda done, total, note="", /: display.update(task, completed=done, total=total)


class Run:
    """A finished run: its numbers and signals.

    Attributes:
        summary: the content of ``summary.json``.
        log: every signal over time; ``run["off_tracking_true"]`` is one of them.
        directory: where it was written or read; None if it is in memory alone.
    """

    def __init__(self, summary: Mapping[str, Any], log: Log, directory: Path | None, result: Result | None) -> None:
        """Use `run` or `load_run`."""
        self.summary, self.log, self.directory = summary, log, directory
        self._result = result

    @property
    def outcome(self) -> str:
        """How it ended; "completed" if all went well."""
        return str(self.summary["outcome"])

    def __getitem__(self, signal: str) -> Values:
        """Values of a signal over time (n,), with its ``unit`` and ``description``; NaN where it has none.

        Raises:
            KeyError: if there is no such signal; it names the most similar one.
        """
        values = self.log[signal].view(Values)
        values.signal = next(one for one in self.log.signals if one.name == signal)
        return values

    def plot(self, *signals: str) -> Figure:
        """Chart of signals over time, a panel for each unit.

        Without names it shows what the run is judged by: true and estimated off-tracking, or slip angle.

        Raises:
            KeyError: if there is no such signal; it names the most similar one.
        """
        from matplotlib import pyplot

        usual = (*("off_tracking_true", "off_tracking_estimate"), *("slip_angle_true", "slip_angle_estimate"))
        columns = [self[name] for name in signals or [name for name in usual if name in self.log]]
        units = list(dict.fromkeys(column.unit for column in columns))
        figure, panels = pyplot.subplots(
            len(units), sharex=True, squeeze=False, figsize=(9.0, 1.0 + 2.5 * len(units)), layout="constrained"
        )
        for column in columns:
            known, panel = np.isfinite(column), panels[units.index(column.unit), 0]
            style = "-" if known.mean() > 0.5 else "."  # estimates have values at the captures alone
            panel.plot(self.log["time"][known], column[known], style, label=column.signal.name if column.signal else "")
            panel.set_ylabel(f"[{column.unit}]")
            panel.legend()
        panels[-1, 0].set_xlabel("time [s]")
        panels[0, 0].set_title(repr(self).strip("<>"))
        return figure

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
            if (value := number_at(self.summary, f"{name}.{key}")) is not None
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
    progress: bool | None = None,
    **keys: Any,
) -> Run:
    """Run a scenario in the closed loop.

    Args:
        scenario: name of a shipped scenario, or a TOML file.
        seed: decides world and noise; the same seed on the same machine gives bitwise the same signals.
        settings: values by dotted keys of the scenario: ``{"surface.friction": 0.3}``; ``offtrack keys`` lists them.
        keep_frames: keep pictures of the camera for the report and the video of `Run.save`.
        progress: show a progress bar; None: in a terminal or a notebook.
        **keys: the same as keyword arguments, with two underscores for a dot: ``surface__friction=0.3``.

    Raises:
        TypeError: one line, if an argument is of another type.
        ValueError: one line that names key, value and limit.
    """
    chosen = load(scenario, settings, keys)
    with shown_progress(f"{chosen.name}, seed {seed}", shown=progress) as report:
        result = run_scenario(chosen, checked_seed(seed), keep_frames=keep_frames, progress=report)
    return Run(result.summary(), result.log, None, result)


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
    return Run(read_summary(folder), read_log(folder / "signals.parquet"), folder, None)


class Session:
    """A run in steps: look at it between them, go on, or copy it to try something else.

    ``copy.deepcopy`` gives a snapshot that goes on bitwise like the original. Snapshots share the renderer of the
    cameras, so close a session only when its snapshots are done.
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str],
        *,
        seed: int = 1,
        settings: Mapping[str, Any] | None = None,
        **keys: Any,
    ) -> None:
        """Begin a run at time 0. The arguments are those of `offtrack.run`.

        Raises:
            TypeError: one line, if an argument is of another type.
            ValueError: one line that names key, value and limit.
        """
        chosen = load(scenario, settings, keys)
        kind, seed = KINDS[chosen.vehicle_kind], checked_seed(seed)
        self._inputs = run_inputs(chosen.model_dump(exclude_none=True))
        self._session = kind.session(kind.assemble(chosen, seed), worker=InLine())

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._session.tick * TICK

    @property
    def outcome(self) -> str | None:
        """How the run has ended; None while it continues."""
        return self._session.outcome

    @property
    def truth(self) -> Truth | RoverTruth:
        """Ground truth now, as the log has it: poses, velocities, wheel loads."""
        truth: Truth | RoverTruth = self._session.truth
        return truth

    @property
    def estimate(self) -> OffTracking | SlipAngle | None:
        """The estimate delivered last: off-tracking of the last trailer, or slip angle of the rover."""
        estimate: OffTracking | SlipAngle | None = self._session.estimate
        return estimate

    def step(self, duration: float | None = None) -> bool:
        """Go on for ``duration`` [s], by default for one step of the loop; return True while the run continues.

        Raises:
            ValueError: if the duration is not positive.
        """
        if duration is not None and not duration > 0.0:
            raise ValueError(f"duration = {duration} s must be positive")
        end = self.time + (duration or 0.0)
        while self.outcome is None:
            self._session.advance()
            if self.time >= end - 0.5 * TICK:
                break
        return self.outcome is None

    def run(self) -> Run:
        """Go on to the end, and return the run."""
        self._session.run()
        return self.result()

    def result(self) -> Run:
        """The run as far as it has come; its outcome is then "unfinished"."""
        result = self._session.result(self._inputs)
        return Run(result.summary(), result.log, None, result)

    def close(self) -> None:
        """Free the renderer of the cameras, and end the processes of FMUs."""
        self._session.close()
        self._session.parts.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
