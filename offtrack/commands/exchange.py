"""`offtrack export`, `draw`, `view` and `fmu`: runs as files, drawings and pages; exchange of models by FMI."""

from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import typer

from offtrack.commands import console as ui
from offtrack.exchange.drawings import drawing, driven_run, formats_of, write_drawing
from offtrack.exchange.exports.catalogue import EXPORT, ExportedRun, ExportFormat, chosen_signals
from offtrack.exchange.fmi_export.fmu_writer import checked_platforms, fmu_bytes, write_fmu
from offtrack.exchange.fmi_export.plant_kinds import plant_model
from offtrack.exchange.fmi_import.fmu_file import open_fmu
from offtrack.exchange.fmi_import.fmu_parts import signals_of
from offtrack.exchange.fmi_import.mapping import first_map, map_file
from offtrack.exchange.fmi_proxy.parts import driver_proxy, ground_proxy, law_of_scenario, sensor_proxy
from offtrack.exchange.fmi_proxy.proxy import Proxy
from offtrack.exchange.fmi_proxy.system import fmu_system
from offtrack.reports.run_files import finished_run, view_page
from offtrack.studies.study_page import names_of_runs, page_link
from scenarios.catalogue import resolve
from scenarios.options.scenario import Scenario, load_any_scenario, load_scenario, of_kind
from scenarios.results.log import read_log
from scenarios.results.run_directory import check_new_file, replaced, replacing
from vehicle.combination.description import load_vehicle
from vehicle.foundation.quantity import check_number

EXPORT_EXAMPLES = (
    "Examples: offtrack export runs/roundabout-1 --to csv   offtrack export runs/roundabout-1 --to mat   "
    "offtrack export runs/roundabout-1 --to mf4 --out roundabout.mf4   "
    "offtrack export runs/roundabout-1 --list   "
    "offtrack export runs/roundabout-1 --signals 'off_tracking*,steer*' --decimal ,   "
    "offtrack run roundabout --record images, then offtrack export runs/roundabout-1 --to mcap --images images   "
    "offtrack export runs/roundabout-1 --to rosbag2 --images images, then offtrack estimate off-tracking "
    "runs/roundabout-1/rosbag2"
)
_SIGNALS = "signals.parquet"
_SCENARIO = "scenario.toml"


def export(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.")],
    to: Annotated[
        str,
        typer.Option(
            help=f"Format: {', '.join(EXPORT)} or package.module:Name. XLSX is for spreadsheets, MAT for MATLAB, MF4 "
            "(ASAM MDF) for measurement tools, MCAP for Foxglove and Lichtblick; a ROS 2 bag is a folder. XLSX, MF4, "
            "MCAP and bags need the extra 'export'."
        ),
    ] = "csv",
    signals: Annotated[
        str | None,
        typer.Option(
            help="Write only the time and the signals of these names, with commas between; * stands for any letters.",
            show_default="all",
        ),
    ] = None,
    listed: Annotated[
        bool, typer.Option("--list", help="List the signals with their units and meanings, and write nothing.")
    ] = False,
    decimal: Annotated[
        Literal[".", ","], typer.Option(help="Decimal mark of csv; with a comma its cells are separated by semicolons.")
    ] = ".",
    images: Annotated[
        Path | None,
        typer.Option(help="Folder that the same run recorded (--record): its images go into the MCAP file or the bag."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Name of the file.", show_default="RUN/signals.FORMAT, RUN/rosbag2")
    ] = None,
    quiet: ui.Quiet = False,
) -> None:
    """Write the signals of a finished run as a file for other tools, with their units and meanings.

    MCAP and ROS 2 bags also hold the moving bodies, their paths and, with --images, the recorded images; offtrack
    estimate reads such a bag. pandas reads RUN/signals.parquet as it is.
    """
    if not (run / _SIGNALS).is_file():
        raise ValueError(f"{run}: is no directory of a finished run: it has no {_SIGNALS}")
    whole = read_log(run / _SIGNALS)
    log = whole if signals is None else chosen_signals(whole, signals)
    if listed:
        ui.PlainConsole().print(ui.listing((one.name, one.unit, one.description) for one in log.signals))
        return
    chosen: type[ExportFormat] = resolve("--to", to, EXPORT)
    if images is not None and not chosen.takes_images:
        with_images = [name for name in EXPORT if resolve("--to", name, EXPORT).takes_images]
        raise ValueError(f"--images {images}: {to} takes no images: choose --to {' or '.join(with_images)}")
    if decimal != "." and to != "csv":
        raise ValueError(f"--decimal {decimal}: {to} holds numbers, not text; only csv has a decimal mark")
    with ui.progress_display(shown=chosen.takes_images and not quiet) as display:
        bar = ui.progress_bar(display, "export")
        exported = ExportedRun(
            log=log, whole=whole, scenario=run / _SCENARIO, images=images, decimal=decimal, progress=bar
        )
        files = chosen.write(exported, out or run / chosen.file)
    if not quiet:
        for path in files:
            typer.echo(f"Signals: {path}")


DRAW_EXAMPLES = (
    "Examples: offtrack draw runs/roundabout-1   offtrack draw runs/roundabout-1 --to geojson   "
    "offtrack draw runs/roundabout-1 --to both --every 2   offtrack draw runs/survey-1 --to geojson --crs EPSG:25832"
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
    crs: Annotated[
        str | None,
        typer.Option(
            help="Coordinate system of the drawing, such as EPSG:25832; a table of metres is taken to be in it. Needs "
            "the extra 'gis'.",
            show_default="that of the course's file",
        ),
    ] = None,
    quiet: ui.Quiet = False,
) -> None:
    """Draw the swept path, the vehicle and the road of a finished run for CAD (DXF) or GIS (GeoJSON).

    Coordinates are those of the course's file: its metres, or degrees (in DXF metres on the plane that touches the
    earth there). A course without a file has metres along the first heading. Needs the extra 'cad'.
    """
    check_number("--every", every, *_EVERY, "m")

    kinds = formats_of(to)
    base = out or run / "drawing"
    files = {kind: base if out and len(kinds) == 1 else base.with_name(f"{base.name}.{kind}") for kind in kinds}
    drawn = drawing(driven_run(run), every=every)
    for path in files.values():
        check_new_file(path)
    for kind, path in files.items():
        write_drawing(drawn, path, kind, crs)
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
    quiet: ui.Quiet = False,
) -> None:
    """Lay finished runs over each other in one page: plan, 3-D view, charts, pictures, and a table of differences.

    The page moves all runs to the same time, or to the same distance driven. It needs no network and no other file.
    """
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


LAW_EXAMPLES = (
    "Examples: offtrack fmu law path_preview --vehicle uk_longer_semitrailer   "
    "offtrack fmu law ct_at --vehicle b_double_steered --fmi 2 -o ct_at.fmu   "
    "offtrack fmu law path_preview --vehicle uk_longer_semitrailer --set steering.gain=0.5   "
    "offtrack run roundabout --set trailer_steering=path_preview_uk_longer_semitrailer.fmu"
)

_KEYS = ("steering", "degradation", "load", "steer_groups", "policy")  # of a scenario, that a law takes
Fmi = Annotated[int, typer.Option(help="Version of FMI: 2 or 3.")]
Out = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Name of the FMU.", show_default="after its content, such as VEHICLE.fmu"),
]
Platforms = Annotated[
    list[str] | None,
    typer.Option(
        help="Further platform with a library in the FMU: linux-arm64 or, of plants alone, win64, darwin64, "
        "darwin-arm64; may be repeated. Needs the extra zig."
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


app = ui.command_group(
    "Co-simulation with other tools by FMI: offtrack's vehicles there, their models here.\n\n"
    "plant writes a truck or rover that Simulink, Dymola, FMPy and others simulate without Python. law, sensor, driver "
    "and ground write parts of offtrack behind which a Python process computes; system writes a whole run.\n\n"
    "An FMU for co-simulation, FMI 2 or 3, is a part of a run where its file is named: trailer_steering=law.fmu. A "
    "TOML file beside it says which of its variables is which signal; map writes a first one."
)


PLANT_EXAMPLES = (
    "Examples: offtrack fmu plant eu_tractor_semitrailer   offtrack fmu plant a_double --fmi 2 -o a_double.fmu   "
    "offtrack fmu plant my_truck.toml --platform win64 -o my_truck.fmu   "
    "offtrack fmu plant el_dorado_ii --soil beach_sand   fmpy info eu_tractor_semitrailer.fmu"
)


@app.command(epilog=ui.lines(PLANT_EXAMPLES))
def plant(
    vehicle: Annotated[str, typer.Argument(help="Vehicle or rover: a name (see: offtrack vehicle) or a TOML file.")],
    fmi: Fmi = 3,
    out: Out = None,
    platform: Platforms = None,
    soil: Annotated[
        str | None, typer.Option(help="Soil that a rover drives in: a name or a TOML file; without it, firm ground.")
    ] = None,
    wind: Annotated[bool, typer.Option("--wind", help="Add inputs for the wind at each unit of a truck.")] = False,
    quiet: ui.Quiet = False,
) -> None:
    """Write a truck or rover as an FMU that runs without Python.

    Its equations are in C, with a library for 64-bit Linux and all source code. It is for co-simulation and steps by 1
    ms inside. The numbers of the vehicle file are parameters; documentation/index.html in the FMU lists all variables,
    and what is fixed. Importing tools give it steer angle, acceleration and the ground; it gives everything that
    offtrack knows of its own vehicle.
    """
    platforms = checked_platforms(platform or [], fmi)
    model = plant_model(vehicle, soil, wind=wind)
    path = new_file(out, model.name, ".fmu")
    write_fmu(path, model, fmi, platforms)
    if not quiet:
        count = Counter(variable.causality for variable in model.interface.variables())
        typer.echo(
            f"FMU: {path} (FMI {fmi}, {', '.join(platforms)}): {count['parameter']} parameters, "
            f"{count['input']} inputs, {count['output']} outputs"
        )


@app.command(epilog=ui.lines(LAW_EXAMPLES))
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
    quiet: ui.Quiet = False,
) -> None:
    """Write a trailer steering law as an FMU.

    It steers the last steered trailer, guarded against bad estimates as in a run. The FMU starts a Python process of an
    environment with offtrack, and ends it. The parameter python or the environment variable OFFTRACK_PYTHON names the
    interpreter; otherwise it is python3 by the search path.
    """
    for setting in settings or []:
        if setting.partition(".")[0].partition("=")[0] not in _KEYS:
            raise ValueError(f"--set {setting}: a law has only the keys {', '.join(_KEYS)}")
    chosen = [f"vehicle={vehicle}", f"trailer_steering={name}", *(settings or [])]
    write_proxy(law_of_scenario(load_scenario("roundabout", chosen)), fmi, out, platform, quiet=quiet)


@app.command(epilog=ui.lines(SENSOR_EXAMPLES))
def sensor(
    scenario: ui.ScenarioName,
    settings: Settings = None,
    seed: Annotated[int, typer.Option(help="Decides world and noise; the start value of the parameter seed.")] = 1,
    fmi: Fmi = 3,
    out: Out = None,
    platform: Platforms = None,
    quiet: ui.Quiet = False,
) -> None:
    """Write the camera loop of a scenario as an FMU.

    It has the world, cameras, odometry and path buffer of the last trailer. It takes the motion of the combination, by
    the names of the outputs of offtrack fmu plant, and gives off-tracking, standard deviation, health and path, and the
    combination's own sensors. The parameter frames is a folder for the images.
    """
    write_proxy(sensor_proxy(of_trailer(scenario, settings), seed), fmi, out, platform, quiet=quiet)


@app.command(epilog=ui.lines(DRIVER_EXAMPLES))
def driver(
    scenario: ui.ScenarioName,
    settings: Settings = None,
    fmi: Fmi = 3,
    out: Out = None,
    platform: Platforms = None,
    quiet: ui.Quiet = False,
) -> None:
    """Write the driver of a scenario as an FMU.

    Its inputs are the motion of the tractor, its outputs steer angle and acceleration.
    """
    write_proxy(driver_proxy(of_trailer(scenario, settings)), fmi, out, platform, quiet=quiet)


@app.command(epilog=ui.lines(GROUND_EXAMPLES))
def ground(
    scenario: ui.ScenarioName,
    settings: Settings = None,
    seed: Annotated[int, typer.Option(help="Decides the roughness; the start value of the parameter seed.")] = 1,
    fmi: Fmi = 3,
    out: Out = None,
    platform: Platforms = None,
    quiet: ui.Quiet = False,
) -> None:
    """Write the ground of a scenario as an FMU.

    Its inputs are the poses of the units, its outputs friction, slopes, heights and wind. These are the inputs of
    offtrack fmu plant, by the same names.
    """
    write_proxy(ground_proxy(of_trailer(scenario, settings), seed), fmi, out, platform, quiet=quiet)


@app.command(epilog=ui.lines(SYSTEM_EXAMPLES))
def system(
    scenario: ui.ScenarioName,
    settings: Settings = None,
    seed: Annotated[int, typer.Option(help="Decides world and noise.")] = 1,
    step: Annotated[float, typer.Option(help="Communication step of the runner [s], up to 0.02.")] = 0.01,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Name of the system.", show_default="SCENARIO.ssp")
    ] = None,
    platform: Platforms = None,
    quiet: ui.Quiet = False,
) -> None:
    """Write a whole run as a system of FMUs in the SSP format.

    It has plant, driver, sensors, laws and their connections. Each steered trailer has its own sensor and law. Uneven
    ground, friction that changes and wind are an FMU as well.
    """
    platforms = checked_platforms(platform or [], 2, by_python=True)
    loop = fmu_system(of_trailer(scenario, settings), seed, step)
    path = new_file(out, loop.name, ".ssp")
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
    return of_kind(
        load_any_scenario(name, settings or []),
        Scenario,
        f"scenario {name} is a rover's: its camera sees the sand that its own wheels have just shaped, which no signal "
        "of an FMU carries; name a trailer's scenario, or write the rover itself: offtrack fmu plant",
    )


def new_file(out: Path | None, name: str, ending: str) -> Path:
    """The file to write: ``out``, or else the name with the ending.

    Raises:
        ValueError: one line, if it has another ending, exists, or can't be written.
    """
    path = out or Path(f"{name}{ending}")
    if path.suffix != ending:
        raise ValueError(f"--out {path}: the name must end in {ending}")
    check_new_file(path)
    return path


def write_proxy(proxy: Proxy, fmi: int, out: Path | None, platform: list[str] | None, *, quiet: bool) -> None:
    """Write an FMU and say what it has.

    Raises:
        ValueError: one line, if it can't be compiled, or the name is wrong.
    """
    platforms = checked_platforms(platform or [], fmi, by_python=True)
    path = new_file(out, proxy.name, ".fmu")
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


@app.command(name="map", epilog=ui.lines(MAP_EXAMPLES))
def map_variables(
    fmu: Annotated[Path, typer.Argument(help="FMU for co-simulation, version 2 or 3 of FMI.")],
    part: Annotated[Part, typer.Option(help="What it shall be in a run.")] = "trailer_steering",
    vehicle: Annotated[
        str, typer.Option(help="Vehicle by name or TOML file; its axles and units decide the signals.")
    ] = "uk_longer_semitrailer",
    out: Annotated[Path | None, typer.Option(help="Name of the map.", show_default="FMU.toml, beside the FMU")] = None,
    quiet: ui.Quiet = False,
) -> None:
    """Write a first map of an FMU: which variable is which signal.

    Signals are found by names and units. Read it, correct it, and run. Everything that was not connected stands in it
    as a comment.
    """
    path = out or map_file(fmu)
    if path.exists():
        raise ValueError(f"{path}: exists, and may have been corrected: remove it, or choose another name with --out")
    check_new_file(path)
    text = first_map(open_fmu(fmu), signals_of(part, load_vehicle(vehicle)))
    replaced(path, text)
    if not quiet:
        typer.echo(f"Map: {path}")
