"""`offtrack validate`: compare the vehicle model with theory, published tables and independent models."""

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

from scenarios.commands.console import CHECK_FAILED, PlainConsole, one_line_errors, progress_bar, progress_display

if TYPE_CHECKING:
    from scenarios.validation.check import Check, Section

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
    from scenarios.results.run_directory import results_directory
    from scenarios.validation.check import tally

    with one_line_errors(), results_directory(out, "validate") as directory:
        begin = time.perf_counter()
        sections = _run_checks(quick, shown=not as_json)
        _write(sections, directory, _run_information(time.perf_counter() - begin, quick))
        if as_json:
            typer.echo(json.dumps(_plain(sections), indent=2))
        else:
            _print(sections, directory)
    if tally(sections)["failed"]:
        raise typer.Exit(CHECK_FAILED)


def _run_checks(quick: bool, *, shown: bool) -> list[Section]:
    from scenarios.validation.suite import TASKS

    sections = []
    with progress_display(shown=shown) as progress:
        report = progress_bar(progress, "validation")
        for done, task in enumerate(TASKS):
            report(done, len(TASKS), task.title)
            sections.append(task.work(quick))
    return sections


def _write(sections: Sequence[Section], directory: Path, facts: dict[str, str]) -> None:
    from scenarios.results.run_directory import appearing_at_once
    from scenarios.validation.validation_page import validation_page

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


def _plain(sections: Sequence[Section]) -> dict[str, Any]:
    """All checks and the number of each verdict, for JSON."""
    from scenarios.validation.check import tally

    checks = [
        {"section": part.title, "verdict": check.verdict, **dataclasses.asdict(check), "value": _finite(check.value)}
        for part in sections
        for check in part.checks
    ]
    return {**tally(sections), "checks": checks}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None  # JSON has no NaN


def _print(sections: Sequence[Section], directory: Path) -> None:
    from scenarios.validation.check import tally

    console = PlainConsole()
    for part in sections:
        _print_section(console, part)
    counts = tally(sections)
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    console.print(verdicts, style="bold red" if counts["failed"] else "bold green")
    console.print(f"Page: {directory / 'validation.html'}", soft_wrap=True)


def _print_section(console: PlainConsole, part: Section) -> None:
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
    from scenarios.validation.check import number

    return (
        check.name + (f" ({check.remark})" if check.remark else ""),
        "-" if check.value is None else number(check.value, check.tolerance),
        f"{number(check.target, check.tolerance)} {check.unit}",
        f"{check.tolerance:.2g}",
        Text(check.verdict, style=_COLOURS[check.verdict]),
    )
