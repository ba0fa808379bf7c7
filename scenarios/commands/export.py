"""`offtrack export`: the signals of a finished run for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scenarios.commands.console import Quiet, one_line_errors

EXAMPLES = (
    "Examples: offtrack export runs/roundabout-1 --to csv   offtrack export runs/roundabout-1 --to mat   "
    "offtrack export runs/roundabout-1 --to mf4 --out roundabout.mf4"
)
Choice = Literal["csv", "mat", "mf4"]
_SIGNALS = "signals.parquet"


def export(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.")],
    to: Annotated[
        Choice,
        typer.Option(
            help="Format: CSV, MAT for MATLAB, or MF4 (ASAM MDF) for measurement tools, which needs the extra 'export'."
        ),
    ] = "csv",
    out: Annotated[Path | None, typer.Option(help="Name of the file.", show_default="RUN/signals.FORMAT")] = None,
    quiet: Quiet = False,
) -> None:
    """Write the signals of a finished run as a file for other tools, with their units and meanings.

    pandas reads RUN/signals.parquet as it is.
    """
    with one_line_errors():
        from scenarios.exports.files import written
        from scenarios.results.log import read_log

        if not (run / _SIGNALS).is_file():
            raise ValueError(f"{run}: is no directory of a finished run: it has no {_SIGNALS}")
        files = written(read_log(run / _SIGNALS), out or run / f"signals.{to}", to)
        if not quiet:
            for path in files:
                typer.echo(f"Signals: {path}")
