"""Shared parts of the commands: one-line errors, exit codes and progress bars."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressDisplay

from scenarios.progress import Progress
from vehicle.user_file import shown

CHECK_FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130

Quiet = Annotated[bool, typer.Option("--quiet", help="Print no progress bar and no table.")]
ScenarioName = Annotated[str, typer.Argument(help="Name of a scenario (see: offtrack scenarios) or a TOML file.")]


@contextmanager
def one_line_errors() -> Iterator[None]:
    """End expected errors in one line on standard error and exit code 2, an interrupt in exit code 130."""
    from sensors.render import RendererUnavailableError

    try:
        yield
    except (ValueError, OSError, RendererUnavailableError) as error:
        remark(str(error))
        raise typer.Exit(BAD_INPUT) from error
    except KeyboardInterrupt as interrupt:
        remark("interrupted; what is finished is kept")
        raise typer.Exit(INTERRUPTED) from interrupt


def remark(line: str) -> None:
    """Print a line on standard error."""
    typer.echo(f"offtrack: {shown(line, 4000)}", file=sys.stderr)


def check_number(option: str, value: float | None, low: float, high: float) -> None:
    """Refuse a number outside its limits; None is accepted.

    Raises:
        ValueError: one line with value and limits.
    """
    if value is not None and not low <= value <= high:  # also NaN
        raise ValueError(f"{option} {value}: must be from {low:g} to {high:g}")


class LazyDisplay(ProgressDisplay):
    """A progress display that appears with the first progress; an unused one leaves no empty line."""

    def __enter__(self) -> LazyDisplay:
        return self

    def __exit__(self, *_: object) -> None:
        if self.live.is_started:
            self.stop()


def progress_display(*, shown: bool) -> LazyDisplay:
    """A rich progress display on standard error; its tasks carry a field ``detail``."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[detail]}"),
    )
    return LazyDisplay(*columns, console=Console(stderr=True), disable=not shown)


def progress_bar(display: ProgressDisplay, title: str) -> Progress:
    """Progress callback that draws a bar, which appears with the first call."""
    tasks: list[TaskID] = []

    def report(done: float, total: float, note: str = "", /) -> None:
        if not tasks:
            display.start()
            tasks.append(display.add_task(title, total=total, detail=""))
        display.update(tasks[0], completed=done, total=total, detail=note)

    return report


def lines(examples: str) -> str:
    """Epilog of a help text with every example on a line of its own; three spaces separate them."""
    return "\b\n" + examples.replace("Examples: ", "Examples:   ", 1).replace("   ", "\n  ")
