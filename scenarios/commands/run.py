"""`offtrack run`: one closed-loop run."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from scenarios.commands.console import INTERRUPTED, one_line_errors, progress_display
from scenarios.options.rover import RoverScenario
from scenarios.options.scenario import Scenario, load_any_scenario

if TYPE_CHECKING:
    from scenarios.results.run import Summary

EXAMPLES = (
    "Examples: offtrack run roundabout --set trailer_steering=none   "
    "offtrack run figure-of-eight --set off_tracking=truth --no-video   "
    "offtrack run roundabout --set surface.friction=0.3 --set surface.cross_fall=0.025   "
    "offtrack run roundabout --set traffic=following --set faults=dropout:0.1   "
    "offtrack run roundabout --set rig.calibration=boards --set rig.self_calibration=true   "
    "offtrack run roundabout --set odometry=viso2 --set viso_ot.smoothing=true (a Kalman filter of the motions)   "
    "offtrack run rover-slope --set slip_compensation=none"
)


def run(
    scenario: Annotated[str, typer.Argument(help="Name of a scenario (see: offtrack scenarios) or a TOML file.")],
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change a key of the scenario, e.g. off_tracking=truth, trailer_steering=none, vehicle=my_truck.toml, "
            "surface.friction=0.3, steering.gain=0.5, traffic=mixed (none, following, overtaking, crossing; "
            "traffic.kind beside traffic.gap in m), rig.calibration=boards (exact). May be repeated.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Decides the world and all noise.")] = 1,
    out: Annotated[
        Path | None, typer.Option(help="Run directory; must not exist yet.", show_default="runs/SCENARIO-N")
    ] = None,
    video: Annotated[bool, typer.Option(help="Write a video (a GIF without the extra 'video').")] = True,
    record: Annotated[
        Path | None, typer.Option(help="Also write the camera's images there: for offtrack estimate.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, no table.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON, and nothing else.")] = False,
) -> None:
    """Run a scenario in the closed loop and write its report, signals and video to a run directory."""
    from scenarios.results.run import check_run_directory, next_run_directory

    with one_line_errors():
        chosen = load_any_scenario(scenario, settings or [])
        directory = out or next_run_directory(chosen.name)
        check_run_directory(directory)
        if record:
            check_run_directory(record)
        with _progress(f"{chosen.name}, seed {seed}", shown=not (quiet or as_json)) as bar:
            numbers = _ran(chosen, seed, directory, record=record, video=video, bar=bar)
        if as_json:
            typer.echo(json.dumps(numbers, indent=2))
        elif not quiet:
            _print_summary(numbers, directory)
    if numbers["outcome"] == "interrupted":
        raise typer.Exit(INTERRUPTED)


def _ran(
    chosen: Scenario | RoverScenario, seed: int, directory: Path, *, record: Path | None, video: bool, bar: _Bar
) -> Summary:
    """Runs the scenario, writes its directory, and gives its numbers."""
    if isinstance(chosen, RoverScenario):
        from scenarios.loop.rover_run import run_rover
        from scenarios.results.rover import rover_summary, write_rover_run

        driven = run_rover(chosen, seed, keep_frames=True, record=record, progress=bar.run)
        write_rover_run(driven, directory, video=video, progress=bar.video)
        return rover_summary(driven)
    from scenarios.loop.run import run as run_scenario
    from scenarios.results.run import summary, write_run

    result = run_scenario(chosen, seed, keep_frames=True, record=record, progress=bar.run, calibrating=bar.calibration)
    write_run(result, directory, video=video, progress=bar.video)
    return summary(result)


class _Bar:
    """Progress of a run and of its video on one rich display, which appears when there is progress to show."""

    def __init__(self, progress: Progress, title: str) -> None:
        self._progress = progress
        self._run = progress.add_task(title, total=1.0, detail="")
        self._calibration: Any = None
        self._video: Any = None

    def run(self, share: float, simulated: float) -> None:
        self._progress.start()
        self._progress.update(self._run, completed=share, detail=f"{simulated:.1f} s simulated")

    def calibration(self, done: int, total: int) -> None:
        self._progress.start()
        if self._calibration is None:
            self._calibration = self._progress.add_task("calibration boards", total=total, detail="")
        self._progress.update(self._calibration, completed=done)

    def video(self, done: int, total: int) -> None:
        if self._video is None:
            self._progress.update(self._run, completed=1.0)
            self._video = self._progress.add_task("video", total=total, detail="")
        self._progress.update(self._video, completed=done)


@contextmanager
def _progress(title: str, *, shown: bool) -> Iterator[_Bar]:
    progress = progress_display(shown=shown)
    try:
        yield _Bar(progress, title)
    finally:
        if progress.live.is_started:  # one that has shown nothing would leave an empty line
            progress.stop()


def _print_summary(numbers: dict[str, Any], directory: Path) -> None:
    console = Console()
    table = Table(title=f"{numbers['scenario']}, seed {numbers['seed']}: {numbers['outcome']}", title_justify="left")
    table.add_column("")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    groups = {**numbers, **numbers.get("trailers", {})}
    for group, values in groups.items():
        if isinstance(values, dict) and group != "trailers":
            for k, (name, value) in enumerate(values.items()):
                shown = "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
                table.add_row(group if k == 0 else "", name, shown, end_section=k == len(values) - 1)
    console.print(table)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True, highlight=False)
