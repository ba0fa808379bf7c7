"""`offtrack run`: run a scenario."""

from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from offtrack.commands import console as ui
from offtrack.exchange.recordings.writers import recording_in
from offtrack.reports.film import IN_FILM
from offtrack.reports.player.encoding import ON_PAGE
from offtrack.reports.run_files import FilmAlong, write_run
from offtrack.reports.watching import Watcher, watched
from scenarios.loop import runner
from scenarios.loop.channel import Pacer
from scenarios.options.scenario import load_any_scenario
from scenarios.progress import interrupted_code, postponed_interrupts
from scenarios.results.run_directory import check_apart, claimed, results_directory
from scenarios.results.run_inputs import changed_modules
from vehicle.foundation.quantity import check_number
from vehicle.foundation.temporary import temporary_folder

_FILES, _SIGNALS = 5e6, 1e5  # space that a run may take [bytes], and for each second of it [bytes/s]

RUN_EXAMPLES = (
    "Examples: offtrack run roundabout --set trailer_steering=none   "
    "offtrack run figure-of-eight --set off_tracking=truth --no-video   "
    "offtrack run roundabout --set surface.friction=0.3 --set surface.cross_fall=0.025   "
    "offtrack run roundabout --set traffic=following --set faults=dropout:0.1   "
    "offtrack run roundabout --set rig.calibration=boards --set rig.self_calibration=true   "
    "offtrack run roundabout --set odometry=viso2 --set viso_ot.smoothing=true (a Kalman filter of the motions)   "
    "offtrack run roundabout --paced --speed 0.5   "
    "offtrack run roundabout --watch   "
    "offtrack run rover-slope --set slip_compensation=none"
)


def run(
    scenario: ui.ScenarioName,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            autocompletion=ui.setting_completions,
            help="Change a key of the scenario (see: offtrack keys), e.g. off_tracking=truth, trailer_steering=none, "
            "vehicle=my_truck.toml, surface.friction=0.3, steering.gain=0.5, traffic=mixed. "
            "May be repeated; the last value of a key counts.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the world and all noise.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Run directory: new, empty, or an interrupted run, which is replaced.", show_default="runs/SCENARIO-N"
        ),
    ] = None,
    video: Annotated[bool, typer.Option(help="Write a video; a GIF if the extra 'video' is not installed.")] = True,
    paced: Annotated[
        bool,
        typer.Option(
            "--paced", help="Keep wall time: each step begins when its time has come; late steps are reported."
        ),
    ] = False,
    speed: Annotated[
        float | None, typer.Option(help="Simulated time over wall time of --paced.", show_default="1")
    ] = None,
    udp: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT[,PORT]",
            help="Send signals to a controller on a bench, and take its demands at the own PORT (outside.demands says "
            "which; see docs/real-time.md).",
        ),
    ] = None,
    can: Annotated[
        str | None,
        typer.Option(
            metavar="dbc=FILE[,interface=I][,channel=C]",
            help="The same on a CAN bus, as a DBC file says; interface virtual or socketcan.",
        ),
    ] = None,
    watch: Annotated[
        bool,
        typer.Option("--watch", help="Print a link to a page on this machine that shows the run while it goes on."),
    ] = False,
    watch_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of --watch.", show_default="any that is free")
    ] = 0,
    record: Annotated[Path | None, typer.Option(help="Folder for the camera images, for offtrack estimate.")] = None,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Run a scenario in the closed loop and write its report, signals and video to a run directory.

    If a part raises an exception, the outcome is "failed", what was computed is written, and the exit code is 1.
    --debug, or OFFTRACK_DEBUG=1, prints the whole trace too.
    """
    with ExitStack() as cleanup:
        check_number("--speed", speed, 0.01, 100.0)
        if speed is not None and not paced:
            raise ValueError(f"--speed {speed:g}: needs --paced")
        chosen = load_any_scenario(scenario, settings or [])
        bench = None
        if udp is not None or can is not None:
            from offtrack.exchange.bench.links import opened_bench

            bench = cleanup.enter_context(opened_bench(udp, can))
        duration = runner.KINDS[chosen.vehicle_kind].duration(chosen)
        space = results_directory(out, chosen.name, space=_FILES + _SIGNALS * duration)
        directory = cleanup.enter_context(space)
        for module in changed_modules(Path(scenario), chosen.model_dump(exclude_none=True)):
            ui.remark(f"own module {module} has changed since the run of {scenario}: the results may be others")
        if record:
            check_apart(directory, record)
            cleanup.enter_context(claimed(record))
        watcher = None
        if watch:
            watcher = Watcher(f"{chosen.name}, seed {seed}")
            ui.remark(f"watch the run: {cleanup.enter_context(watched(watcher, watch_port))}")
        film = None
        if video and not paced and find_spec("av"):  # a paced run has no time for it
            folder = cleanup.enter_context(temporary_folder())
            film = FilmAlong(folder, duration)
            cleanup.callback(film.end)
        with ui.progress_display(shown=not (quiet or as_json)) as display, postponed_interrupts() as checked:
            result = runner.run(
                chosen,
                seed,
                keep_frames=IN_FILM if video else ON_PAGE,
                record=recording_in(record) if record else None,
                progress=checked(ui.progress_bar(display, f"{chosen.name}, seed {seed}")),
                calibration_progress=checked(ui.progress_bar(display, "calibration boards")),
                pacer=Pacer(1.0 if speed is None else speed) if paced else None,
                bench=bench,
                watch=[one.step for one in (watcher, film) if one is not None],
            )
            if watcher is not None:
                watcher.show(result)
                watcher.finish(f"{result.outcome}; its page will be {directory / 'report.html'}")
            drawn = film or (video and result.outcome != "interrupted")
            bar = checked(ui.progress_bar(display, "video"))
            write_run(result, directory, video=drawn, progress=bar, recording=record)
        numbers = result.summary()
        ui.answer(numbers, lambda: _print_summary(numbers, directory), quiet=quiet, as_json=as_json)
    if numbers["outcome"] == "interrupted":
        ui.remark(f"interrupted; what was computed until then is in {directory}")
        raise typer.Exit(interrupted_code())
    if result.traceback:
        typer.echo(f"offtrack: {result.outcome} (see {directory / 'traceback.txt'})", err=True)
        if ui.debugging():
            typer.echo(result.traceback, err=True)
        raise typer.Exit(ui.CHECK_FAILED)


def _print_summary(numbers: dict[str, Any], directory: Path) -> None:
    console = ui.PlainConsole()
    groups = {**numbers, **numbers.get("trailers", {})}
    shown = {name: values for name, values in groups.items() if isinstance(values, dict) and name != "trailers"}
    title = f"{numbers['scenario']}, seed {numbers['seed']}: {numbers['outcome']}"
    console.print(ui.summary_table(title, shown))
    for warning in numbers.get("warnings", ()):
        console.print(f"Warning: {warning}", soft_wrap=True, style="yellow")
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True)
