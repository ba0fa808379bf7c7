"""Shared parts of the commands: one-line errors, exit codes, plain text on the terminal and progress bars."""

import json
import os
import re
import shlex
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Final, cast

import typer
from rich.console import Console
from rich.progress import BarColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressDisplay
from rich.table import Column, Table
from rich.text import Text
from typer.core import TyperGroup

from scenarios.progress import Progress, interrupted_code, raise_interrupts
from vehicle.foundation.own_parts import raised_at
from vehicle.foundation.user_file import reason, shown

if TYPE_CHECKING:
    from offtrack.reports import page

_LONGEST: Final = 1000  # characters of an error message
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_USAGE_ERROR: Final = cast(type[Exception], typer.BadParameter.__base__)  # of click, which newer typers bring along
_DEBUG: Final = "OFFTRACK_DEBUG"
_OPTION: Final = "--debug"
_COMPLETE: Final = "_OFFTRACK_COMPLETE"  # environment: set by a shell that asks for completions
CHECK_FAILED, BAD_INPUT = 1, 2


def scenario_completions(incomplete: str) -> list[str]:
    """Names of scenarios that begin like this."""
    from scenarios.options.shipped import scenario_names

    return [name for name in scenario_names() if name.startswith(incomplete)]


def setting_completions(incomplete: str) -> list[str]:
    """Keys that begin like this, or values of a key: choices, and parts of the kind that has its name."""
    from scenarios import part_listing

    key, equals, begun = (_cut["key"], "=", incomplete) if _cut else incomplete.partition("=")
    every = part_listing.keys()
    if not equals:
        return [f"{one.name}=" for one in every if one.name.startswith(key) and "[]" not in one.name]
    parts = [part.name for part in part_listing.parts(key)] if key in part_listing.KINDS else []
    words = [word for one in every if one.name == key and ", " in one.range for word in one.range.split(", ")]
    head = "" if key == _cut.get("key") else f"{key}="  # bash completes what is behind the sign
    return [f"{head}{value}" for value in (parts or words) if value.startswith(begun)]


_cut: dict[str, str] = {}  # the key, if bash has cut the setting to complete behind its equals sign


def join_settings() -> None:
    """Put together what bash, which asks for completions, has cut at each equals sign; keep the key of the last one."""
    if os.environ.get(_COMPLETE) != "complete_bash":
        return
    place = int(os.environ.get("COMP_CWORD", "0"))
    *words, last = (os.environ.get("COMP_WORDS", "").split(" ") + [""] * (place + 1))[: place + 1]
    if last == "=":
        words, last = [*words, last], ""
    if words[-1:] == ["="] and len(words) > 1:
        _cut["key"] = words[-2]
        words = words[:-2]
    joined = re.sub(r" = ", "=", " ".join(words))
    os.environ |= {"COMP_WORDS": f"{joined} {last}", "COMP_CWORD": str(len(joined.split(" ")))}


AsJson = Annotated[bool, typer.Option("--json", help="Print the results as JSON and nothing else.")]
SettingsOfAll = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        autocompletion=setting_completions,
        help="Change a key of the scenario in all runs, e.g. off_tracking=truth. May be repeated.",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print no progress bar and no table.")]


def new_directory(show_default: str) -> Any:
    """Option ``--out`` of a command that writes a directory, by default the next one of this name."""
    return typer.Option(help="Output directory; it must not exist yet.", show_default=show_default)


ScenarioName = Annotated[
    str,
    typer.Argument(
        help="Name of a scenario (see: offtrack scenarios) or a TOML file.", autocompletion=scenario_completions
    ),
]


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """End expected errors, and those of the user's own code, in one line on standard error and exit code 2.

    An interrupt ends in the exit code of its signal.
    """
    try:
        yield
    except (BrokenPipeError, typer.Exit):  # whoever read the output has gone: no error of the command
        raise
    except KeyboardInterrupt as interrupt:
        remark(f"interrupted; {str(interrupt) or 'what is finished is kept'}")
        raise typer.Exit(interrupted_code()) from interrupt
    except Exception as error:
        render = sys.modules.get("sensors.render")  # its import takes long, and without it nothing was rendered
        if isinstance(error, MemoryError):
            line = f"not enough memory: {error}".removesuffix(": ")
        elif isinstance(error, ValueError | OSError) or (render and isinstance(error, render.RendererUnavailableError)):
            line = _line(error)
        elif place := raised_at(error):
            line = f"{type(error).__name__}: {error}{place}"
        else:
            raise
        if debugging():
            typer.echo(traceback.format_exc(), err=True)
        remark(line)
        raise typer.Exit(BAD_INPUT) from error


def debugging() -> bool:
    """True if the whole trace of an error is wanted: ``--debug``, or OFFTRACK_DEBUG=1."""
    return bool(os.environ.get(_DEBUG))


def _line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None:
        return f"{shown(str(error.filename))}: {reason(error)}"
    return str(error)


def remark(line: str) -> None:
    """Print a line on standard error."""
    typer.echo(f"offtrack: {shown(line, _LONGEST)}", file=sys.stderr)


class OneLineGroup(TyperGroup):
    """Commands whose errors are one line; every one of them takes ``--debug``."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; an expected error ends it in one line."""
        with _one_line_errors():
            return super().invoke(ctx)

    def main(self, args: Any = None, *more: Any, standalone_mode: bool = True, **options: Any) -> Any:
        """Run the command that the arguments name, and exit with its code unless it is not the whole program."""
        arguments = list(sys.argv[1:] if args is None else args)
        if _OPTION in arguments:
            arguments = [argument for argument in arguments if argument != _OPTION]
            os.environ[_DEBUG] = "1"  # worker processes too
        args = arguments
        foreign = [one for one in arguments if re.search("[\udc80-\udcff]", one)]
        if foreign and sys.getfilesystemencoding() != "utf-8":
            remark(f"{foreign[0]}: this locale has no such letter: set LC_ALL=C.UTF-8, or PYTHONUTF8=1")
            sys.exit(BAD_INPUT)
        if not standalone_mode:
            return super().main(args, *more, **options, standalone_mode=False)  # type: ignore[misc]
        try:
            code = super().main(args, *more, **options, standalone_mode=False)  # type: ignore[misc]
        except _USAGE_ERROR as error:
            problem: Any = error
            if type(error).__name__ == "NoArgsIsHelpError":
                problem.show()
            else:
                command = getattr(problem.ctx, "command_path", "offtrack")
                remark(f"{problem.format_message().rstrip('.')}; see {command} --help")
            sys.exit(BAD_INPUT)
        sys.exit(code if isinstance(code, int) else 0)


def command_group(text: str) -> typer.Typer:
    """A command with subcommands, with plain help; ``text`` is its help."""
    return typer.Typer(cls=OneLineGroup, no_args_is_help=True, add_completion=False, rich_markup_mode=None, help=text)


class PlainConsole(Console):
    """A console on which texts are plain: brackets are no markup, control characters are shown as escapes."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False, highlight=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """The text, whose file names and names of units may come from anywhere."""
        return super().render_str(printable(text), **options)


def table_of(*columns: str, title: str | None = None, **style: Any) -> Table:
    """An empty table with these headings; a column that begins with ``>`` is aligned to the right."""
    table = Table(title=title, title_justify="left", **style)
    for column in columns:
        table.add_column(column.removeprefix(">"), justify="right" if column.startswith(">") else "left")
    return table


_STYLES: Final = {"": "", "bad": "red", "good": "green", "soft": "dim", "best": "bold"}  # of a cell of a page


def page_table(shown: "page.Table", title: str | None = None, **style: Any) -> Table:
    """A page's table for the terminal, without the columns that have no text."""
    rows = [[(cell, "") if isinstance(cell, str) else (cell.text, cell.emphasis) for cell in row] for row in shown.rows]
    kept = [k for k in range(len(shown.columns)) if any(len(row) == 1 or row[k][0] for row in rows)]
    columns = [shown.columns[k] for k in kept]
    table = table_of(*((">" if one.kind == "number" else "") + one.title for one in columns), title=title, **style)
    for row in rows:
        cells = [row[k] for k in kept] if len(row) > 1 else [(row[0][0], "best")]
        table.add_row(*(Text(printable(text), style=_STYLES[emphasis]) for text, emphasis in cells))
    return table


def answer(numbers: object, show: Callable[[], None], *, quiet: bool = False, as_json: bool = False) -> None:
    """Print the numbers as JSON, or else what ``show`` prints; nothing of the latter if it is to be quiet."""
    if as_json:
        typer.echo(json.dumps(numbers, indent=2))
    elif not quiet:
        show()


def listing(rows: Iterable[Sequence[str | Text]]) -> Table:
    """Rows without lines and headings."""
    table = Table(box=None, show_header=False, pad_edge=False)
    for row in rows:
        table.add_row(*row)
    return table


def summary_table(title: str, groups: Mapping[str, Mapping[str, Any]]) -> Table:
    """Numbers of a summary by group and name."""
    table = table_of("", "quantity", ">value", title=title)
    for group, values in groups.items():
        for k, (name, value) in enumerate(values.items()):
            shown = "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
            table.add_row(group if k == 0 else "", name, shown, end_section=k == len(values) - 1)
    return table


def printable(text: str) -> str:
    """The text with control characters, which a terminal may obey, as escapes."""
    return _CONTROL.sub(lambda control: repr(control[0])[1:-1], text)


class LazyDisplay(ProgressDisplay):
    """A progress display that appears with the first progress; an unused one leaves no empty line."""

    def __enter__(self) -> "LazyDisplay":
        return self

    def __exit__(self, _: object, error: object, __: object) -> None:
        if not self.live.is_started:
            return
        if isinstance(error, ValueError | OSError):  # one line, and no more
            self.live.transient = True
            self.live.stop()
        else:
            self.stop()


def progress_display(*, shown: bool) -> LazyDisplay:
    """A rich progress display on standard error; its tasks carry a field ``detail``."""
    columns = (
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, ratio=2)),
        BarColumn(bar_width=16),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        TextColumn("left"),
        TextColumn("{task.fields[detail]}", markup=False, table_column=Column(no_wrap=True, ratio=3)),
    )  # those with a ratio get what the others leave
    return LazyDisplay(*columns, console=PlainConsole(stderr=True), disable=not shown, expand=True)


def progress_bar(display: ProgressDisplay, title: str) -> Progress:
    """Progress callback that draws a bar, which appears with the first call."""
    tasks: list[TaskID] = []

    def report(done: float, total: float, note: str = "", /) -> None:
        if not tasks:
            raise_interrupts()
            display.start()
            tasks.append(display.add_task(printable(title), total=total, detail=""))
        display.update(tasks[0], completed=done, total=total, detail=printable(note))

    return report


@contextmanager
def continuable() -> Iterator[None]:
    """Add to an interrupt the command that continues."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        command = shlex.join(["offtrack", *sys.argv[1:]])
        raise KeyboardInterrupt(f"{str(interrupt) or 'what is finished is kept'}; continue: {command}") from None


def lines(examples: str) -> str:
    """Epilog of a help text with every example on a line of its own; three spaces separate them."""
    return "\b\n" + examples.replace("Examples: ", "Examples:   ", 1).replace("   ", "\n  ")
