"""`offtrack reproduce`: reproduce tables and figures of papers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from scenarios.commands.console import (
    INTERRUPTED,
    PlainConsole,
    Quiet,
    one_line_errors,
    progress_bar,
    progress_display,
    remark,
)

if TYPE_CHECKING:
    from scenarios.reproduce.figure import Reproduction

EXAMPLES = "Examples: offtrack reproduce reina2008-table3   offtrack reproduce all --quick --out papers"


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
    from scenarios.reproduce.catalogue import names_of
    from scenarios.reproduce.figure import earlier_reproduction, write_reproduction
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
                _print(reproduction, directory)
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
    from scenarios.reproduce.catalogue import maker

    with progress_display(shown=shown) as display:
        return maker(name)(quick, progress_bar(display, name))


def _print(result: Reproduction, directory: Path) -> None:
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
