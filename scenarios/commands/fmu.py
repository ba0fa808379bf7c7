"""`offtrack fmu`: co-simulation with other tools by FMI."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import typer

from scenarios.commands import fmu_proxies
from scenarios.commands.console import OneLineGroup, Quiet, lines, one_line_errors

Part = Literal["trailer_steering", "off_tracking", "driver", "plant"]
MAP_EXAMPLES = (
    "Examples: offtrack fmu map law.fmu   offtrack fmu map truck.fmu --part plant --vehicle eu_tractor_semitrailer   "
    "offtrack run roundabout --set trailer_steering=law.fmu   offtrack run roundabout --set driver=driver.fmu   "
    "offtrack run roundabout --set plant.fmu=truck.fmu --set vehicle=eu_tractor_semitrailer"
)

PLANT_EXAMPLES = (
    "Examples: offtrack fmu plant eu_tractor_semitrailer   offtrack fmu plant a_double --fmi 2 -o a_double.fmu   "
    "offtrack fmu plant my_truck.toml --platform win64 -o my_truck.fmu   "
    "offtrack fmu plant el_dorado_ii --soil beach_sand   fmpy info eu_tractor_semitrailer.fmu"
)

app = typer.Typer(
    cls=OneLineGroup,
    no_args_is_help=True,
    rich_markup_mode=None,
    help=(
        "Co-simulation with other tools by FMI: offtrack's vehicles there, their models here.\n\n"
        "offtrack fmu plant writes a truck or rover as an FMU that Simulink, Dymola, FMPy and others simulate without "
        "Python. offtrack fmu law, sensor, driver and ground write parts of offtrack behind which a Python process "
        "computes; offtrack fmu system writes a whole run.\n\n"
        "An FMU for co-simulation, FMI 2 or 3, is a part of a run where its file is named: trailer_steering=law.fmu. A "
        "TOML file beside it says which of its variables is which signal; offtrack fmu map writes a first one."
    ),
)


@app.callback()
def _fmu() -> None:
    """Co-simulation with other tools by FMI."""


@app.command(epilog=lines(PLANT_EXAMPLES))
def plant(
    vehicle: Annotated[str, typer.Argument(help="Vehicle or rover: a name (see: offtrack vehicle) or a TOML file.")],
    fmi: Annotated[int, typer.Option(help="Version of FMI: 2 or 3.")] = 3,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Name of the FMU.", show_default="VEHICLE.fmu")
    ] = None,
    platform: Annotated[
        list[str] | None,
        typer.Option(
            help="Further platform with a library in the FMU: win64, darwin64, linux-arm64, darwin-arm64; may be "
            "repeated. Needs the extra zig."
        ),
    ] = None,
    soil: Annotated[
        str | None, typer.Option(help="Soil that a rover drives in: a name or a TOML file; without it, firm ground.")
    ] = None,
    wind: Annotated[bool, typer.Option("--wind", help="Add inputs for the wind at each unit of a truck.")] = False,
    quiet: Quiet = False,
) -> None:
    """Write a truck or rover as an FMU: its equations in C, with a library for 64-bit Linux and all source code.

    It is for co-simulation, steps by 1 ms inside, and runs without Python. The numbers of the vehicle file are
    parameters; documentation/index.html in the FMU lists all variables, and what is fixed. Importing tools give it
    steer angle, acceleration and the ground; it gives everything that offtrack knows of its own vehicle.
    """
    with one_line_errors():
        from scenarios.fmi_export.archive import write_fmu
        from scenarios.fmi_export.binaries import checked_platforms
        from scenarios.fmi_export.plants import plant_model
        from scenarios.results.files import check_new_file

        if fmi not in (2, 3):
            raise ValueError(f"--fmi {fmi}: must be 2 or 3")
        platforms = checked_platforms(platform or [], fmi)
        model = plant_model(vehicle, soil, wind=wind)
        path = out or Path(f"{model.name}.fmu")
        if path.suffix != ".fmu":
            raise ValueError(f"--out {path}: the name must end in .fmu")
        check_new_file(path)
        write_fmu(path, model, fmi, platforms)
        if not quiet:
            count = Counter(variable.causality for variable in model.interface.variables())
            typer.echo(
                f"FMU: {path} (FMI {fmi}, {', '.join(platforms)}): {count['parameter']} parameters, "
                f"{count['input']} inputs, {count['output']} outputs"
            )


app.command(epilog=lines(fmu_proxies.LAW_EXAMPLES))(fmu_proxies.law)
app.command(epilog=lines(fmu_proxies.SENSOR_EXAMPLES))(fmu_proxies.sensor)
app.command(epilog=lines(fmu_proxies.SYSTEM_EXAMPLES))(fmu_proxies.system)
app.command(epilog=lines(fmu_proxies.DRIVER_EXAMPLES))(fmu_proxies.driver)
app.command(epilog=lines(fmu_proxies.GROUND_EXAMPLES))(fmu_proxies.ground)


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
        from scenarios.fmi_import.first_map import first_map
        from scenarios.fmi_import.mapping import map_file
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
