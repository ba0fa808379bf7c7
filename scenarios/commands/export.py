"""`offtrack export`: the signals of a finished run for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scenarios.commands.console import Quiet, one_line_errors, progress_bar, progress_display

EXAMPLES = (
    "Examples: offtrack export runs/roundabout-1 --to csv   offtrack export runs/roundabout-1 --to mat   "
    "offtrack export runs/roundabout-1 --to mf4 --out roundabout.mf4   "
    "offtrack run roundabout --record images, then offtrack export runs/roundabout-1 --to mcap --images images   "
    "offtrack export runs/roundabout-1 --to rosbag2 --images images, then offtrack estimate off-tracking "
    "runs/roundabout-1/rosbag2"
)
Choice = Literal["csv", "mat", "mf4", "mcap", "rosbag2"]
_SIGNALS = "signals.parquet"
_SCENARIO = "scenario.toml"


def export(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.")],
    to: Annotated[
        Choice,
        typer.Option(
            help="Format: CSV, MAT for MATLAB, MF4 (ASAM MDF) for measurement tools, MCAP for Foxglove and Lichtblick, "
            "or a ROS 2 bag (a folder). MF4, MCAP and bags need the extra 'export'."
        ),
    ] = "csv",
    images: Annotated[
        Path | None,
        typer.Option(help="Folder that the same run recorded (--record): its images go into the MCAP file or the bag."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Name of the file.", show_default="RUN/signals.FORMAT, RUN/rosbag2")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write the signals of a finished run as a file for other tools, with their units and meanings.

    MCAP and ROS 2 bags also hold the moving bodies, their paths and, with --images, the recorded images; offtrack
    estimate reads such a bag. pandas reads RUN/signals.parquet as it is.
    """
    with one_line_errors():
        from scenarios.exports.files import written
        from scenarios.exports.mcap import write_mcap
        from scenarios.exports.rosbag2 import write_rosbag2
        from scenarios.results.log import read_log

        if not (run / _SIGNALS).is_file():
            raise ValueError(f"{run}: is no directory of a finished run: it has no {_SIGNALS}")
        write_all = {"mcap": write_mcap, "rosbag2": write_rosbag2}.get(to)
        if images is not None and write_all is None:
            raise ValueError(f"--images {images}: only MCAP and bags hold images: add --to mcap or --to rosbag2")
        log, path = read_log(run / _SIGNALS), out or run / ("rosbag2" if to == "rosbag2" else f"signals.{to}")
        if write_all is not None:
            with progress_display(shown=not quiet) as display:
                shown = progress_bar(display, "export")
                files: tuple[Path, ...] = (write_all(log, run / _SCENARIO, path, images=images, progress=shown),)
        else:
            files = written(log, path, to)  # type: ignore[arg-type]  # the others are written above
        if not quiet:
            for path in files:
                typer.echo(f"Signals: {path}")
