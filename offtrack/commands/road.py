"""`offtrack road`: what a map or track holds, what of it can be driven, and how."""

import shlex
from pathlib import Path
from typing import Annotated, Final

import typer

from offtrack.commands.console import AsJson, PlainConsole, Quiet, answer, new_directory, table_of
from offtrack.reports.road_map import RoadMap, road_map, write_map
from offtrack.reports.run_files import write_json
from scenarios.results.run_directory import appearing_at_once, results_directory

EXAMPLES: Final = (
    "Examples: offtrack road town.xodr   offtrack road track.gpx --vehicle eu_tractor_semitrailer   "
    "offtrack road depot.csv --json   offtrack road lines.geojson --out lines"
)
_MOST: Final = 60  # rows of a table on the terminal


def road(
    file: Annotated[
        Path, typer.Argument(help="A map (.xodr), a track (.gpx, .geojson), points (.csv) or a measured road (.crg).")
    ],
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle that is to drive there: a name or a TOML file.", show_default=False)
    ] = None,
    out: Annotated[Path | None, new_directory("runs/road-NAME-N")] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Show what a map or track holds, what of it can be driven, and the command that drives it.

    A map is listed by roads, lanes and the ways through its junctions, with the word of course.route for each way. A
    track is listed with its length, smallest radius, steepest grade and largest jump. What cannot be driven has the
    reason beside it. A plan with the ids of roads and lanes is drawn as plan.svg and plan.png; facts.json holds
    everything.
    """
    with results_directory(out, f"road-{file.stem}") as directory:
        found = road_map(file, vehicle)
        with appearing_at_once(directory) as folder:
            write_map(found, folder)
            write_json(folder / "facts.json", found.numbers)
    answer(found.numbers, lambda: _print(found, directory), quiet=quiet, as_json=as_json)


def _print(found: RoadMap, directory: Path) -> None:
    console = PlainConsole()
    console.print(found.summary, soft_wrap=True)
    for title, (head, *rows) in found.tables.items():
        if not rows:
            continue
        table = table_of(*((">" if "[" in name else "") + name for name in head), title=title)
        for row in rows[:_MOST]:
            table.add_row(*row)
        console.print(table)
        if len(rows) > _MOST:
            console.print(f"{len(rows) - _MOST} more are in {directory / 'facts.json'}", soft_wrap=True)
    for remark in found.remarks[:_MOST]:
        console.print(f"Note: {remark}", soft_wrap=True)
    if found.drive:
        settings = " ".join(f"--set {shlex.quote(one)}" for one in found.drive)
        console.print(f"Drive it:  offtrack run roundabout --set off_tracking=truth {settings}", soft_wrap=True)
    if "lanes" in found.numbers:
        console.print(
            "Elsewhere: --set course.road=ROAD --set course.lane=LANE --set course.route=WORD,...", soft_wrap=True
        )
    console.print(f"Plan:      {directory / 'plan.svg'}, plan.png", soft_wrap=True)
