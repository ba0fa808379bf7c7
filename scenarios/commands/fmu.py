"""`offtrack fmu`: co-simulation with other tools by FMI."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from scenarios.commands.console import OneLineGroup, Quiet, lines, one_line_errors

Part = Literal["trailer_steering", "driver", "plant"]
MAP_EXAMPLES = (
    "Examples: offtrack fmu map law.fmu   offtrack fmu map truck.fmu --part plant --vehicle eu_tractor_semitrailer   "
    "offtrack run roundabout --set trailer_steering=law.fmu   offtrack run roundabout --set driver=driver.fmu   "
    "offtrack run roundabout --set plant.fmu=truck.fmu --set vehicle=eu_tractor_semitrailer"
)

app = typer.Typer(
    cls=OneLineGroup,
    no_args_is_help=True,
    rich_markup_mode=None,
    help=(
        "Use FMUs of other tools as steering law, driver or plant.\n\n"
        "An FMU for co-simulation, FMI 2 or 3, is a part of a run where its file is named: trailer_steering=law.fmu. A "
        "TOML file beside it says which of its variables is which signal; offtrack fmu map writes a first one."
    ),
)


@app.callback()
def _fmu() -> None:
    """Co-simulation with other tools by FMI."""


@app.command(name="map", epilog=lines(MAP_EXAMPLES))
def map_variables(
    fmu: Annotated[Path, typer.Argument(help="FMU for co-simulation, version 2 or 3 of FMI.")],
    part: Annotated[Part, typer.Option(help="What it shall be in a run.")] = "trailer_steering",
    vehicle: Annotated[
        str, typer.Option(help="Vehicle by name or TOML file; its axles and units decide the signals.")
    ] = "uk_longer_semitrailer",
    out: Annotated[Path | None, typer.Option(help="Name of the map.", show_default="FMU.toml, beside the FMU")] = None,
    quiet: Quiet = False,
) -> None:
    """Write a first map of an FMU: which of its variables is which signal, by names and units.

    Read it, correct it, and run. Everything that was not connected stands in it as a comment.
    """
    with one_line_errors():
        from scenarios.fmi_import.archive import open_fmu
        from scenarios.fmi_import.mapping import first_map, map_file
        from scenarios.fmi_import.signals import signals_of
        from scenarios.results.files import check_new_file, replaced
        from vehicle.combination.description import load_vehicle

        path = out or map_file(fmu)
        if path.exists():
            raise ValueError(
                f"{path}: exists, and may have been corrected: remove it, or choose another name with --out"
            )
        check_new_file(path)
        text = first_map(open_fmu(fmu), signals_of(part, load_vehicle(vehicle)))
        replaced(path, text)
        if not quiet:
            typer.echo(f"Map: {path}")
