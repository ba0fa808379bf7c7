"""`offtrack validate` and `offtrack reproduce`: compare offtrack with theory, tables and figures of papers."""

from __future__ import annotations

import dataclasses
import json
import math
import platform
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Table
from rich.text import Text

from offtrack.commands.console import (
    CHECK_FAILED,
    INTERRUPTED,
    PlainConsole,
    Quiet,
    one_line_errors,
    progress_bar,
    progress_display,
    remark,
)

if TYPE_CHECKING:
    from offtrack.studies.reproduce.reproduction import Reproduction
    from offtrack.studies.validation.check import Check, CheckSection


_COLOURS: Final = {"passed": "green", "failed": "red", "skipped": "yellow"}


def validate(
    out: Annotated[
        Path | None,
        typer.Option(help="Output directory for the page; it must not exist yet.", show_default="runs/validate-N"),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Run fewer cases: about half a minute.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print all numbers as JSON and nothing else.")] = False,
) -> None:
    """Compare the vehicle model with closed forms, published tables and independent models.

    Prints every number with its target, tolerance and source, and writes a page with plots. The exit code is 1 if a
    number is out of tolerance.
    """
    from offtrack.studies.validation.check import tally
    from scenarios.results.run_directory import results_directory

    with one_line_errors(), results_directory(out, "validate") as directory:
        begin = time.perf_counter()
        sections = _run_checks(quick, shown=not as_json)
        _write(sections, directory, _run_information(time.perf_counter() - begin, quick))
        if as_json:
            typer.echo(json.dumps(_plain(sections), indent=2))
        else:
            _print_sections(sections, directory)
    if tally(sections)["failed"]:
        raise typer.Exit(CHECK_FAILED)


def _run_checks(quick: bool, *, shown: bool) -> list[CheckSection]:
    from offtrack.studies.validation.suite import TASKS

    sections = []
    with progress_display(shown=shown) as progress:
        report = progress_bar(progress, "validation")
        for done, task in enumerate(TASKS):
            report(done, len(TASKS), task.title)
            sections.append(task.work(quick))
    return sections


def _write(sections: Sequence[CheckSection], directory: Path, facts: dict[str, str]) -> None:
    from offtrack.studies.validation.suite import validation_page
    from scenarios.results.run_directory import appearing_at_once

    page = validation_page(sections, facts)
    with appearing_at_once(directory) as folder:
        (folder / "validation.html").write_text(page, encoding="utf-8")
        (folder / "validation.json").write_text(json.dumps(_plain(sections), indent=2) + "\n", encoding="utf-8")


def _run_information(seconds: float, quick: bool) -> dict[str, str]:
    versions = ", ".join(f"{name} {version(name)}" for name in ("casadi", "numpy", "scipy"))
    return {
        "offtrack": version("offtrack"),
        "python": platform.python_version(),
        "libraries": versions,
        "cases": "quick: fewer cases" if quick else "all",
        "computing time": f"{seconds:.0f} s",
    }


def _plain(sections: Sequence[CheckSection]) -> dict[str, Any]:
    """All checks and the number of each verdict, for JSON."""
    from offtrack.studies.validation.check import tally

    checks = [
        {"section": part.title, "verdict": check.verdict, **dataclasses.asdict(check), "value": _finite(check.value)}
        for part in sections
        for check in part.checks
    ]
    return {**tally(sections), "checks": checks}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None  # JSON has no NaN


def _print_sections(sections: Sequence[CheckSection], directory: Path) -> None:
    from offtrack.studies.validation.check import tally

    console = PlainConsole()
    for part in sections:
        _print_section(console, part)
    counts = tally(sections)
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    console.print(verdicts, style="bold red" if counts["failed"] else "bold green")
    console.print(f"Page: {directory / 'validation.html'}", soft_wrap=True)


def _print_section(console: PlainConsole, part: CheckSection) -> None:
    """Print the checks of a section and, below, the numbered sources."""
    sources = list(dict.fromkeys(check.source for check in part.checks))
    table = Table(title=part.title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.add_column("quantity", ratio=1)
    for name in ("model", "target", "±"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("source", justify="right", no_wrap=True)
    for check in part.checks:
        table.add_row(*_row(check), f"[{1 + sources.index(check.source)}]")
    console.print(table)
    for k, source in enumerate(sources):
        console.print(f"  [{1 + k}] {source}", style="dim")
    console.print()


def _row(check: Check) -> tuple[str | Text, ...]:
    from offtrack.studies.validation.check import number

    return (
        check.name + (f" ({check.remark})" if check.remark else ""),
        "-" if check.value is None else number(check.value, check.tolerance),
        f"{number(check.target, check.tolerance)} {check.unit}",
        f"{check.tolerance:.2g}",
        Text(check.verdict, style=_COLOURS[check.verdict]),
    )


REPRODUCE_EXAMPLES = "Examples: offtrack reproduce reina2008-table3   offtrack reproduce all --quick --out papers"


def reproduce(
    name: Annotated[
        str,
        typer.Argument(
            help="One of reina2008-table2, -table3, -table3-plus, -fig6, -fig8; "
            "desaxe2018-fig6 to -fig9, -fig13 to -fig16; or all."
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Use fewer images and shorter drives: a few minutes each.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output directory for picture, data and numbers; it must not exist yet. With all: a folder in it for "
            "each.",
            show_default="runs/NAME-N",
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON and nothing else.")] = False,
) -> None:
    """Reproduce a paper's table or figure and print it with the published numbers.

    Ctrl-C stops it. Finished results are kept, and an unfinished figure shows its finished drives. With all and --out,
    the same command makes those that are missing.
    """
    from offtrack.studies.reproduce.reproduction import earlier_reproduction, names_of, write_reproduction
    from scenarios.results.run_directory import check_run_directory, next_run_directory

    with one_line_errors():
        names = names_of(name)
        directories = [_directory(out, one, len(names) > 1) or next_run_directory(one) for one in names]
        settings = {"quick": quick}
        several, shown = len(names) > 1, not (quiet or as_json)
        earlier = {
            one: earlier_reproduction(one, directory, settings) if several else None
            for one, directory in zip(names, directories, strict=True)
        }
        for one, directory in zip(names, directories, strict=True):
            if not earlier[one]:
                check_run_directory(directory)
        results: list[dict[str, Any]] = []
        for one, directory in zip(names, directories, strict=True):
            kept = earlier[one]
            if kept:
                remark(f"{one}: finished earlier, in {directory}")
                results.append(kept)
                continue
            reproduction = _reproduce(one, quick, shown=shown)
            write_reproduction(reproduction, directory, settings)
            results.append(reproduction.as_plain())
            if shown:
                _print_reproduction(reproduction, directory)
            if reproduction.interrupted:
                break
        if as_json:
            typer.echo(json.dumps(results if several else results[0], indent=2, ensure_ascii=False))
    if results[-1]["interrupted"]:
        remark(f"interrupted; what is finished is in {directory}")
        raise typer.Exit(INTERRUPTED)


def _directory(out: Path | None, name: str, several: bool) -> Path | None:
    return out / name if out and several else out


def _reproduce(name: str, quick: bool, *, shown: bool) -> Reproduction:
    from offtrack.studies.reproduce.reproduction import maker

    with progress_display(shown=shown) as display:
        return maker(name)(quick, progress_bar(display, name))


def _print_reproduction(result: Reproduction, directory: Path) -> None:
    table = Table(title=f"{result.title} ({result.source})", title_justify="left")
    table.add_column("quantity")
    for column in ("published", "own"):
        table.add_column(column, justify="right")
    table.add_column("unit")
    for one in result.comparisons:
        table.add_row(one.quantity, one.published or "–", one.own_text, one.unit)
    console = PlainConsole()
    console.print(table)
    for note in result.notes:
        console.print(note, style="dim")
    console.print(f"Picture, data and numbers: {directory}", soft_wrap=True)
