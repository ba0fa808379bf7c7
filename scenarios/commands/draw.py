"""`offtrack draw`: a finished run as a drawing for CAD or GIS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scenarios.commands.console import Quiet, check_number, one_line_errors

EXAMPLES = (
    "Examples: offtrack draw runs/roundabout-1   offtrack draw runs/roundabout-1 --to geojson   "
    "offtrack draw runs/roundabout-1 --to both --every 2"
)
Choice = Literal["dxf", "geojson", "both"]
_EVERY = (0.1, 1000.0)  # [m]


def draw(
    run: Annotated[Path, typer.Argument(help="Directory of a trailer's run.")],
    to: Annotated[Choice, typer.Option(help="Format of the file: DXF for CAD, GeoJSON for GIS.")] = "dxf",
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
    with one_line_errors():
        check_number("--every", every, *_EVERY)
        from scenarios.drawings.content import drawing, missing_package
        from scenarios.drawings.files import formats_of, needed_packages, write_drawing
        from scenarios.drawings.of_run import driven_run
        from scenarios.results.files import check_new_file

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
