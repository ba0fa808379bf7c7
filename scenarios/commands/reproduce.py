"""`offtrack reproduce`: tables and figures of the papers, published beside own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from scenarios.commands.console import INTERRUPTED, one_line_errors, progress_bar, progress_display

if TYPE_CHECKING:
    from scenarios.reproduce.figure import Reproduction

EXAMPLES = "Examples: offtrack reproduce reina2008-table3   offtrack reproduce all --quick --out papers"


def reproduce(
    name: Annotated[
        str,
        typer.Argument(
            help="reina2008-table2, -table3, -table3-plus, -fig6, -fig8; "
            "desaxe2018-fig6 to -fig9, -fig13 to -fig16; or all."
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer images, shorter drives: a minute or few for each.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Directory for picture, data and numbers; must not exist yet. With all, one folder in it for each.",
            show_default="runs/NAME-N",
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, no table.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON, and nothing else.")] = False,
) -> None:
    """Make a table or figure of a paper again, and print the published numbers beside one's own.

    Ctrl-C ends all of it; what is finished is kept, also the drives of a figure that others are missing of.
    """
    from scenarios.reproduce.catalogue import names_of
    from scenarios.reproduce.figure import write_reproduction
    from scenarios.results.run_directory import check_run_directory, next_run_directory

    with one_line_errors():
        names = names_of(name)
        directories = [_directory(out, one, len(names) > 1) or next_run_directory(one) for one in names]
        for directory in directories:
            check_run_directory(directory)
        made = []
        for one, directory in zip(names, directories, strict=True):
            made.append(_made(one, quick, shown=not (quiet or as_json)))
            write_reproduction(made[-1], directory, {"quick": quick})
            if not (quiet or as_json):
                _print(made[-1], directory)
            if made[-1].interrupted:
                break
        if as_json:
            plain = [reproduction.as_plain() for reproduction in made]
            typer.echo(json.dumps(plain if len(names) > 1 else plain[0], indent=2, ensure_ascii=False))
    if made[-1].interrupted:
        raise typer.Exit(INTERRUPTED)


def _directory(out: Path | None, name: str, several: bool) -> Path | None:
    return out / name if out and several else out


def _made(name: str, quick: bool, *, shown: bool) -> Reproduction:
    from scenarios.reproduce.catalogue import maker

    with progress_display(shown=shown) as display:
        return maker(name)(quick, progress_bar(display, name))


def _print(made: Reproduction, directory: Path) -> None:
    table = Table(title=f"{made.title} ({made.source})", title_justify="left")
    table.add_column("quantity")
    for column in ("published", "own"):
        table.add_column(column, justify="right")
    table.add_column("unit")
    for one in made.comparisons:
        table.add_row(one.quantity, one.published or "–", one.own_text, one.unit)
    console = Console(highlight=False)
    console.print(table)
    for note in made.notes:
        console.print(note, style="dim", markup=False)
    console.print(f"Picture, data and numbers: {directory}", soft_wrap=True)
