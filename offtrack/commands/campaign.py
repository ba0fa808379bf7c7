"""`offtrack campaign`: how often a loop fails its requirements under faults."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from offtrack.commands import console as ui
from offtrack.commands.study import StudyOptions, takes_study_options
from offtrack.studies.campaigns.campaign import Campaign, campaign_names, campaign_path, load_campaign, with_changes
from offtrack.studies.campaigns.campaign_page import searches_table, times_table
from offtrack.studies.campaigns.failures import Cell, totals, unaccepted
from offtrack.studies.campaigns.run_campaign import Results, default_campaign, results_json, run_campaign
from offtrack.studies.case import listed, seeds_of
from offtrack.studies.study import settings_of
from scenarios.options.shipped import scenario_names
from vehicle.foundation.user_file import nearest, shown

EXAMPLES = (
    "Examples: offtrack campaign --list   offtrack campaign roundabout --set course.turn_deg=90   "
    "offtrack campaign roundabout-low-friction --controllers path_preview,mpc --seeds 1-4   "
    "offtrack campaign trailer-steering-faults   "
    'Example of a CAMPAIGN.toml:   scenario = "roundabout"   seeds = [1, 2]   [set]   off_tracking = "surrogate"   '
    '[vary]   trailer_steering = ["path_preview", "mpc"]   surface.friction = [0.8, 0.3]   '
    '[[fault]]   kind = "gyro_bias"   amounts = [1, 5]   onsets = [6, 9]   durations = [2, "end"]   '
    "[requirements]   off_tracking.true_max_m = 0.5   time_to_detect_s = 1   time_to_recover_s = 5   "
    '[[bisect]]   fault = "gyro_bias"   low = 0   high = 20   tolerance = 0.5   [accept]   probability = 0.1'
)


@takes_study_options
def campaign(
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="CAMPAIGN | SCENARIO",
            help="Name of a campaign (see --list) or its TOML file; or a scenario, for a campaign with every fault "
            "that it can have.",
            show_default=False,
        ),
    ] = None,
    settings: ui.SettingsOfAll = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds, as 1-5 or 1,2,7.", show_default="those of the file; 1-2")
    ] = None,
    controllers: Annotated[
        str | None,
        typer.Option(
            help="Of a scenario: comma-separated trailer steering laws; for a rover, values of slip_compensation.",
            show_default="path_preview,mpc,virtual_driver; none,heading,crab",
        ),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="List the campaigns that come with offtrack.")] = False,
    *,
    options: StudyOptions,
) -> None:
    """Run a fault campaign: the probability that a loop fails its requirements, for each fault and law.

    It prints a table and writes a report: intervals of the probabilities, times to detect and to recover, the worst
    runs, and the smallest fault that fails. Finished runs are saved at once: repeat the command to continue. The exit
    code is 1 if a probability may be larger than [accept] allows.
    """
    if listed or target is None:
        _list(as_json=options.as_json)
        raise typer.Exit(0 if listed else ui.BAD_INPUT)
    chosen = _campaign(target, settings or [], seeds, controllers)
    title = f"campaign-{Path(target).stem if target.endswith('.toml') else target}"
    if options.status:
        options.tell_status(title, chosen)
        return
    with options.opened(title) as run_options:
        found = run_campaign(title, chosen, options.out, run_options)
    broken = [_not_accepted(chosen, cell) for cell in unaccepted(chosen, found.cells)]
    if options.as_json:
        typer.echo(json.dumps(results_json(chosen, found), indent=2, allow_nan=False))
    elif not options.quiet:
        _print(chosen, found, broken)
    if broken:
        for line in broken if options.quiet or options.as_json else ():
            ui.remark(line)
        raise typer.Exit(ui.CHECK_FAILED)


def _campaign(target: str, settings: list[str], seeds: str | None, controllers: str | None) -> Campaign:
    changes, chosen = settings_of(settings, "--set"), None if seeds is None else seeds_of(seeds)
    laws = None if controllers is None else listed(controllers, "--controllers")
    path = campaign_path(target)
    if path is not None:
        if laws:
            raise ValueError(f"--controllers {controllers}: the laws are in [vary] of {path}")
        return with_changes(load_campaign(path), changes, chosen)
    known = [*campaign_names(), *scenario_names()]
    if not target.endswith(".toml") and target not in known:
        raise ValueError(f"unknown campaign or scenario '{shown(target)}'{nearest(target, known)}")
    return default_campaign(target, changes, laws, chosen)


def _list(*, as_json: bool) -> None:
    paths = {name: path for name in campaign_names() if (path := campaign_path(name))}
    loaded = {name: load_campaign(path) for name, path in paths.items()}
    rows = [{"name": n, "runs": len(c.cases()), "description": c.description} for n, c in loaded.items()]
    table = ui.listing((name, f"{len(one.cases())} runs", one.description) for name, one in loaded.items())
    ui.answer(rows, lambda: ui.PlainConsole().print(table), as_json=as_json)


def _print(campaign: Campaign, found: Results, broken: list[str]) -> None:
    console = ui.PlainConsole()
    console.print(_matrix(campaign, [*found.cells, *totals(found.cells)], console.width))
    console.print("failed/runs, and the 95 % interval of the probability [%]")
    for cell in (cell for cell in found.cells if cell.crashed):
        console.print(f"failed without a physical end: {cell.crashed} of {_name(cell)}", soft_wrap=True)
    for table in (times_table(campaign, found.cells), searches_table(found.searches)):
        if table.rows:
            console.print(ui.page_table(table, box=None, pad_edge=False, padding=(0, 1, 0, 0)))
    if lost := sum(not run.reached for run in found.runs):
        console.print(f"{lost} runs were completed before their fault began; they are left out")
    for line in broken:
        console.print(line, soft_wrap=True)
    console.print(f"Report: {found.directory / 'report.html'}", soft_wrap=True)


def _not_accepted(campaign: Campaign, cell: Cell) -> str:
    bound = 100.0 * cell.failing.interval()[1]
    limit = 100.0 * (campaign.accept.probability if campaign.accept else 0.0)
    return f"not accepted: {_name(cell)}: up to {bound:.1f} %, allowed {limit:g} %"


def _name(cell: Cell) -> str:
    return " · ".join(filter(None, cell.place))


def _matrix(campaign: Campaign, cells: list[Cell], width: int) -> Table:
    laws = list(dict.fromkeys(cell.place[2] for cell in cells))
    of_place = {cell.place: cell for cell in cells}
    lines = list(dict.fromkeys(cell.place[:2] for cell in cells))
    left = _longest([fault for fault, _ in lines]) + _longest([further for _, further in lines]) + 2
    widest = max(len(_field(cell, full=True)) for cell in cells)
    headings = [law.replace("_", "_\n") for law in laws]
    full = left + sum(1 + max(widest, _longest(heading.split("\n"))) for heading in headings) <= width
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("fault", no_wrap=True)
    if campaign.further:
        table.add_column("", no_wrap=True)
    for heading in headings:
        table.add_column(heading or "runs", justify="right", no_wrap=full)
    for fault, further in lines:
        fields = [of_place.get((fault, further, law)) for law in laws]
        texts = [_field(cell, full=full) if cell else "-" for cell in fields]
        table.add_row(fault, *([further] if campaign.further else []), *texts)
    return table


def _longest(texts: list[str]) -> int:
    return max(map(len, texts), default=0)


def _field(cell: Cell, *, full: bool) -> str:
    low, high = cell.failing.interval()
    counted = f"{cell.failing.beyond}/{cell.failing.runs}"
    return f"{counted} {100 * low:.0f}-{100 * high:.0f}" if full else counted
