"""`offtrack fmu law`: offtrack's own parts as FMUs with a Python process behind them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scenarios.commands.console import Quiet, one_line_errors

if TYPE_CHECKING:
    from scenarios.fmi_proxy.description import Proxy
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
        from scenarios.fmi_proxy.law import law_of_scenario
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
        from scenarios.fmi_proxy.sensor import sensor_proxy

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
        from scenarios.fmi_proxy.driver import driver_proxy

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
        from scenarios.fmi_proxy.ground import ground_proxy

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
        from scenarios.fmi_export.binaries import checked_platforms
        from scenarios.fmi_proxy.system import fmu_system
        from scenarios.results.files import check_new_file, replacing

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
    from scenarios.options.scenario import Scenario, load_any_scenario

    scenario = load_any_scenario(name, settings or [])
    if isinstance(scenario, Scenario):
        return scenario
    raise ValueError(
        f"scenario {name} is a rover's: its camera sees the sand that its own wheels have just shaped, which no signal "
        "of an FMU carries; name a trailer's scenario, or write the rover itself: offtrack fmu plant"
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
    from scenarios.fmi_export.archive import fmu_bytes
    from scenarios.fmi_export.binaries import checked_platforms
    from scenarios.results.files import check_new_file, replacing

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
