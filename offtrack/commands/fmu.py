"""`offtrack fmu`: co-simulate with other tools by FMI; read FMUs and write offtrack's parts as FMUs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from offtrack.commands.console import OneLineGroup, Quiet, lines, one_line_errors

if TYPE_CHECKING:
    from offtrack.exchange.fmi_proxy.proxy import Proxy
    from scenarios.options.scenario import Scenario


LAW_EXAMPLES = (
    "Examples: offtrack fmu law path_preview --vehicle uk_longer_semitrailer   "
    "offtrack fmu law ct_at --vehicle b_double_steered --fmi 2 -o ct_at.fmu   "
    "offtrack fmu law path_preview --vehicle uk_longer_semitrailer --set steering.gain=0.5   "
    "offtrack run roundabout --set trailer_steering=path_preview_uk_longer_semitrailer.fmu"
)

_KEYS = ("steering", "degradation", "load", "steer_groups", "policy")  # of a scenario, that a law takes
Fmi = Annotated[int, typer.Option(help="Version of FMI: 2 or 3.")]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Name of the FMU.", show_default="after its content")]
Platforms = Annotated[
    list[str] | None,
    typer.Option(
        help="Further platform with a library in the FMU, such as win64; may be repeated. Needs the extra zig."
    ),
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="KEY=VALUE of the scenario; may be repeated.", show_default=False)
]
SENSOR_EXAMPLES = (
    "Examples: offtrack fmu sensor roundabout   offtrack fmu sensor roundabout --set off_tracking=truth --fmi 2   "
    "offtrack run roundabout --set off_tracking=roundabout_sensor.fmu"
)
DRIVER_EXAMPLES = (
    "Examples: offtrack fmu driver roundabout   offtrack fmu driver depot --fmi 2 -o driver.fmu   "
    "offtrack run roundabout --set driver=roundabout_driver.fmu"
)
GROUND_EXAMPLES = (
    "Examples: offtrack fmu ground roundabout --set surface.cross_fall=0.03   "
    "offtrack fmu ground farm-track --fmi 2 --seed 3 -o ground.fmu"
)
SYSTEM_EXAMPLES = (
    "Examples: offtrack fmu system roundabout   "
    "offtrack fmu system turn-90 --set off_tracking=truth --set surface.friction=0.5 -o loop.ssp"
)


def law(
    name: Annotated[
        str, typer.Argument(help="Law by its name (see: offtrack parts trailer_steering), or module:Name.")
    ],
    vehicle: Annotated[str, typer.Option(help="Vehicle by name or TOML file: the data sheet that the law goes by.")],
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", help="KEY=VALUE as of a scenario: steering.…, degradation.…, load, steer_groups, policy."
        ),
    ] = None,
    fmi: Fmi = 3,
    out: Out = None,
    platform: Platforms = None,
    quiet: Quiet = False,
) -> None:
    """Write a trailer steering law as an FMU: guarded against bad estimates as in a run, for the last steered trailer.

    The FMU starts a Python process of an environment with offtrack, and ends it. The parameter python or the
    environment variable OFFTRACK_PYTHON names the interpreter; otherwise it is python3 by the search path.
    """
    with one_line_errors():
        from offtrack.exchange.fmi_proxy.law_proxy import law_of_scenario
        from scenarios.options.scenario import load_scenario

        check_version(fmi)
        for setting in settings or []:
            if setting.partition(".")[0].partition("=")[0] not in _KEYS:
                raise ValueError(f"--set {setting}: a law has only the keys {', '.join(_KEYS)}")
        chosen = [f"vehicle={vehicle}", f"trailer_steering={name}", *(settings or [])]
        written(law_of_scenario(load_scenario("roundabout", chosen)), fmi, out, platform, quiet=quiet)


def sensor(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a TOML file.")],
    settings: Settings = None,
    seed: Annotated[int, typer.Option(help="Decides world and noise; the start value of the parameter seed.")] = 1,
    fmi: Fmi = 3,
    out: Out = None,
    platform: Platforms = None,
    quiet: Quiet = False,
) -> None:
    """Write the camera loop of a scenario as an FMU: world, cameras, odometry and path buffer of its last trailer.

    It takes the motion of the combination, by the names of the outputs of offtrack fmu plant, and gives off-tracking,
    standard deviation, health and path, and the combination's own sensors. The parameter frames is a folder for the
    images.
    """
    with one_line_errors():
        from offtrack.exchange.fmi_proxy.sensor_proxy import sensor_proxy

        check_version(fmi)
        written(sensor_proxy(of_trailer(scenario, settings), seed), fmi, out, platform, quiet=quiet)


def driver(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a TOML file.")],
    settings: Settings = None,
    fmi: Fmi = 3,
    out: Out = None,
    platform: Platforms = None,
    quiet: Quiet = False,
) -> None:
    """Write the driver of a scenario as an FMU: motion of the tractor in, steer angle and acceleration out."""
    with one_line_errors():
        from offtrack.exchange.fmi_proxy.driver_and_ground import driver_proxy

        check_version(fmi)
        written(driver_proxy(of_trailer(scenario, settings)), fmi, out, platform, quiet=quiet)


def ground(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a TOML file.")],
    settings: Settings = None,
    seed: Annotated[int, typer.Option(help="Decides the roughness; the start value of the parameter seed.")] = 1,
    fmi: Fmi = 3,
    out: Out = None,
    platform: Platforms = None,
    quiet: Quiet = False,
) -> None:
    """Write the ground of a scenario as an FMU: poses of the units in; friction, slopes, heights and wind out.

    Its outputs are the inputs of offtrack fmu plant, by the same names.
    """
    with one_line_errors():
        from offtrack.exchange.fmi_proxy.driver_and_ground import ground_proxy

        check_version(fmi)
        written(ground_proxy(of_trailer(scenario, settings), seed), fmi, out, platform, quiet=quiet)


def system(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario, or a TOML file.")],
    settings: Settings = None,
    seed: Annotated[int, typer.Option(help="Decides world and noise.")] = 1,
    step: Annotated[float, typer.Option(help="Communication step of the runner [s], up to 0.02.")] = 0.01,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Name of the system.", show_default="SCENARIO.ssp")
    ] = None,
    platform: Platforms = None,
    quiet: Quiet = False,
) -> None:
    """Write a whole run as a system of FMUs in the SSP format: plant, driver, sensors, laws and their connections.

    Each steered trailer has its own sensor and law. Uneven ground, friction that changes and wind are an FMU as well.
    """
    with one_line_errors():
        from offtrack.exchange.fmi_export.fmu_writer import checked_platforms
        from offtrack.exchange.fmi_proxy.system import fmu_system
        from scenarios.results.atomic_files import check_new_file, replacing

        platforms = checked_platforms(platform or [], 2)
        loop = fmu_system(of_trailer(scenario, settings), seed, step)
        path = out or Path(f"{loop.name}.ssp")
        if path.suffix != ".ssp":
            raise ValueError(f"--out {path}: the name must end in .ssp")
        check_new_file(path)
        with replacing(path) as unfinished:
            unfinished.write_bytes(loop.content(platforms))
        if not quiet:
            typer.echo(
                f"System: {path} ({', '.join(loop.components)}; {len(loop.connections)} connections): steps of "
                f"{step:g} s, ends after {loop.stop:.1f} s"
            )


def of_trailer(name: str, settings: list[str] | None) -> Scenario:
    """A trailer's scenario.

    Raises:
        ValueError: one line, if there is no such scenario, or if it is a rover's.
    """
    from scenarios.options.scenario import Scenario, load_any_scenario, of_kind

    return of_kind(
        load_any_scenario(name, settings or []),
        Scenario,
        f"scenario {name} is a rover's: its camera sees the sand that its own wheels have just shaped, which no signal "
        "of an FMU carries; name a trailer's scenario, or write the rover itself: offtrack fmu plant",
    )


def check_version(fmi: int) -> None:
    """Refuse an unknown version of FMI.

    Raises:
        ValueError: one line.
    """
    if fmi not in (2, 3):
        raise ValueError(f"--fmi {fmi}: must be 2 or 3")


def written(proxy: Proxy, fmi: int, out: Path | None, platform: list[str] | None, *, quiet: bool) -> None:
    """Write an FMU and say what it has.

    Raises:
        ValueError: one line, if it can't be compiled, or the name is wrong.
    """
    from offtrack.exchange.fmi_export.fmu_writer import checked_platforms, fmu_bytes
    from scenarios.results.atomic_files import check_new_file, replacing

    platforms = checked_platforms(platform or [], fmi)
    path = out or Path(f"{proxy.name}.fmu")
    if path.suffix != ".fmu":
        raise ValueError(f"--out {path}: the name must end in .fmu")
    check_new_file(path)
    exported = proxy.exported(fmi)
    with replacing(path) as unfinished:
        unfinished.write_bytes(fmu_bytes(exported, fmi, platforms))
    if not quiet:
        count = {kind: sum(one.causality == kind for one in exported.variables) for kind in ("input", "output")}
        typer.echo(
            f"FMU: {path} (FMI {fmi}, {', '.join(platforms)}): {count['input']} inputs, {count['output']} outputs; "
            f"steps of {proxy.step:g} s"
        )


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
        from offtrack.exchange.fmi_export.fmu_writer import checked_platforms, write_fmu
        from offtrack.exchange.fmi_export.plant_kinds import plant_model
        from scenarios.results.atomic_files import check_new_file

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


app.command(epilog=lines(LAW_EXAMPLES))(law)
app.command(epilog=lines(SENSOR_EXAMPLES))(sensor)
app.command(epilog=lines(SYSTEM_EXAMPLES))(system)
app.command(epilog=lines(DRIVER_EXAMPLES))(driver)
app.command(epilog=lines(GROUND_EXAMPLES))(ground)


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
        from offtrack.exchange.fmi_import.fmu_file import open_fmu
        from offtrack.exchange.fmi_import.fmu_parts import signals_of
        from offtrack.exchange.fmi_import.mapping import first_map, map_file
        from scenarios.results.atomic_files import check_new_file, replaced
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
