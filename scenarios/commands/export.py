"""`offtrack export`: the signals of a finished run for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scenarios.commands.console import Quiet, one_line_errors, progress_bar, progress_display

EXAMPLES = (
    "Examples: offtrack export runs/roundabout-1 --to csv   offtrack export runs/roundabout-1 --to mat   "
    "offtrack export runs/roundabout-1 --to mf4 --out roundabout.mf4   "
    "offtrack run roundabout --record images, then offtrack export runs/roundabout-1 --to mcap --images images"
)
Choice = Literal["csv", "mat", "mf4", "mcap"]
_SIGNALS = "signals.parquet"
_SCENARIO = "scenario.toml"


def export(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.")],
    to: Annotated[
        Choice,
        typer.Option(
            help="Format: CSV, MAT for MATLAB, MF4 (ASAM MDF) for measurement tools, or MCAP for Foxglove and "
            "Lichtblick. MF4 and MCAP need the extra 'export'."
        ),
    ] = "csv",
    images: Annotated[
        Path | None,
        typer.Option(help="Folder that the same run recorded (--record): its images go into the MCAP file."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Name of the file.", show_default="RUN/signals.FORMAT")] = None,
    quiet: Quiet = False,
) -> None:
    """Write the signals of a finished run as a file for other tools, with their units and meanings.

    MCAP also holds the moving bodies, their paths and, with --images, the recorded images. pandas reads
    RUN/signals.parquet as it is.
    """
    with one_line_errors():
        from scenarios.exports.files import written
        from scenarios.exports.mcap import write_mcap
        from scenarios.results.log import read_log

        if not (run / _SIGNALS).is_file():
            raise ValueError(f"{run}: is no directory of a finished run: it has no {_SIGNALS}")
        if images is not None and to != "mcap":
            raise ValueError(f"--images {images}: only MCAP holds images: add --to mcap")
        log, path = read_log(run / _SIGNALS), out or run / f"signals.{to}"
        if to == "mcap":
            with progress_display(shown=not quiet) as display:
                shown = progress_bar(display, "export")
                files: tuple[Path, ...] = (write_mcap(log, run / _SCENARIO, path, images=images, progress=shown),)
        else:
            files = written(log, path, to)
        if not quiet:
            for path in files:
                typer.echo(f"Signals: {path}")
