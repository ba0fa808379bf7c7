"""`offtrack export`, `draw` and `view`: write finished runs as files, as a drawing or as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from offtrack.commands.console import Quiet, one_line_errors, progress_bar, progress_display

EXPORT_EXAMPLES = (
    "Examples: offtrack export runs/roundabout-1 --to csv   offtrack export runs/roundabout-1 --to mat   "
    "offtrack export runs/roundabout-1 --to mf4 --out roundabout.mf4   "
    "offtrack run roundabout --record images, then offtrack export runs/roundabout-1 --to mcap --images images   "
    "offtrack export runs/roundabout-1 --to rosbag2 --images images, then offtrack estimate off-tracking "
    "runs/roundabout-1/rosbag2"
)
SignalFormat = Literal["csv", "mat", "mf4", "mcap", "rosbag2"]
_SIGNALS = "signals.parquet"
_SCENARIO = "scenario.toml"


def export(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.")],
    to: Annotated[
        SignalFormat,
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
        from offtrack.exchange.exports.log_files import written
        from offtrack.exchange.exports.mcap import write_mcap
        from offtrack.exchange.exports.rosbag2 import write_rosbag2
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


DRAW_EXAMPLES = (
    "Examples: offtrack draw runs/roundabout-1   offtrack draw runs/roundabout-1 --to geojson   "
    "offtrack draw runs/roundabout-1 --to both --every 2"
)
DrawingFormat = Literal["dxf", "geojson", "both"]
_EVERY = (0.1, 1000.0)  # [m]


def draw(
    run: Annotated[Path, typer.Argument(help="Directory of a trailer's run.")],
    to: Annotated[DrawingFormat, typer.Option(help="Format of the file: DXF for CAD, GeoJSON for GIS.")] = "dxf",
    out: Annotated[
        Path | None,
        typer.Option(
            help="Name of the file, without the ending if there are two.", show_default="RUN/drawing.dxf, .geojson"
        ),
    ] = None,
    every: Annotated[float, typer.Option(help="Distance between the drawn places of the vehicle [m].")] = 5.0,
    quiet: Quiet = False,
) -> None:
    """Draw the swept path, the vehicle and the road of a finished run for CAD (DXF) or GIS (GeoJSON).

    Coordinates are metres in the frame of the course. Needs the extra 'cad': pip install 'offtrack[cad]'.
    """
    from vehicle.foundation.quantity import check_number

    with one_line_errors():
        check_number("--every", every, *_EVERY, "m")
        from offtrack.exchange.drawings import (
            drawing,
            driven_run,
            formats_of,
            missing_package,
            needed_packages,
            write_drawing,
        )
        from scenarios.results.atomic_files import check_new_file

        kinds = formats_of(to)
        if missing := missing_package(needed_packages(kinds)):
            raise ValueError(missing)
        base = out or run / "drawing"
        files = {kind: base if out and len(kinds) == 1 else base.with_name(f"{base.name}.{kind}") for kind in kinds}
        drawn = drawing(driven_run(run), every=every)
        for path in files.values():
            check_new_file(path)
        for kind, path in files.items():
            write_drawing(drawn, path, kind)
            if not quiet:
                typer.echo(f"Drawing: {path}")


VIEW_EXAMPLES = (
    "Examples: offtrack view runs/roundabout-1 runs/roundabout-2   offtrack view runs/roundabout-1   "
    "offtrack view runs/rover-slope-1 runs/rover-slope-2 --out slopes.html"
)
_LONGEST_NAME = 100


def view(
    runs: Annotated[list[Path], typer.Argument(help="Directories of finished runs, all of trailers or all of rovers.")],
    out: Annotated[
        Path | None, typer.Option(help="Name of the page; it is replaced.", show_default="runs/view-RUN-RUN.html")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Lay finished runs over each other in one page: plan, 3-D view, charts, pictures, and a table of differences.

    The page moves all runs to the same time, or to the same distance driven. It needs no network and no other file.
    """
    with one_line_errors():
        from offtrack.reports.viewing import finished_run, view_page
        from offtrack.studies.study_page import names_of_runs, page_link
        from scenarios.results.atomic_files import replaced

        names = names_of_runs(runs)
        page = out or Path("runs") / (f"view-{'-'.join(run.resolve().name for run in runs)}"[:_LONGEST_NAME] + ".html")
        if page.is_dir() or not (page.parent.is_dir() or out is None):
            raise ValueError(f"--out {page}: must be a file in an existing folder")
        finished = [finished_run(run, name) for run, name in zip(runs, names, strict=True)]
        links = [page_link(run, page.parent) for run in runs]
        text = view_page(finished, links)
        page.parent.mkdir(parents=True, exist_ok=True)
        replaced(page, text)
        if not quiet:
            typer.echo(f"Page: {page}")
