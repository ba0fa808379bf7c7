"""`offtrack scenarios`, `parts` and `keys`: list what there is to choose."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from offtrack.commands.console import AsJson, PlainConsole, listing
from scenarios.options.shipped import scenario_names, shipped_table

if TYPE_CHECKING:
    from scenarios.part_listing import Key

PARTS_EXAMPLES = "Examples: offtrack parts   offtrack parts trailer_steering   offtrack parts fault --json"
KEYS_EXAMPLES = "Examples: offtrack keys roundabout   offtrack keys rover-slope   offtrack keys roundabout --find sun"
Find = Annotated[
    str, typer.Option(metavar="TEXT", help="Show only entries that contain this text.", show_default=False)
]


def scenarios(
    name: Annotated[
        str | None, typer.Argument(help="A scenario to show in full, by its name or TOML file.", show_default=False)
    ] = None,
) -> None:
    """List all scenarios, or show one in full. Run one with: offtrack run NAME."""
    if name is None:
        PlainConsole().print(listing((known, shipped_table(known)["description"]) for known in scenario_names()))
        return
    from rich.syntax import Syntax  # the list needs none of these

    from scenarios.options.scenario import load_any_scenario

    scenario = load_any_scenario(name)
    console = PlainConsole()
    console.print(f"{scenario.name}: {scenario.description}", soft_wrap=True)
    console.print(Syntax(scenario.to_toml(), "toml", background_color="default", word_wrap=True))
    console.print(f"Run it:     offtrack run {name}", soft_wrap=True)
    console.print(f"Change it:  offtrack keys {name}", soft_wrap=True)


def parts(
    kind: Annotated[
        str | None, typer.Argument(help="Kind of parts, e.g. trailer_steering; all kinds if not given.")
    ] = None,
    find: Find = "",
    as_json: AsJson = False,
) -> None:
    """List the replaceable parts with their parameters, defaults, units and ranges.

    Choose a part with --set KEY=NAME, or your own with --set KEY=package.module:Name.
    """
    from scenarios import part_listing

    matches = [part for part in part_listing.parts(kind) if find.lower() in f"{part.name} {part.meaning}".lower()]
    if as_json:
        typer.echo(json.dumps([asdict(part) for part in matches], indent=2, ensure_ascii=False))
        return
    console, kinds = PlainConsole(), dict.fromkeys(part.kind for part in matches)
    for heading in kinds:
        table = _table("part", "value", "range", "meaning", title=heading)
        for part in (part for part in matches if part.kind == heading):
            table.add_row(part.name, "", "", part.meaning)
            for key in part.parameters:
                table.add_row(f"  {key.name}", _value(key), key.range, key.meaning)
        console.print(table)


def keys(
    scenario: Annotated[
        str | None,
        typer.Argument(help="Scenario whose values are shown as defaults; all keys of trailer scenarios if not given."),
    ] = None,
    find: Find = "",
    as_json: AsJson = False,
) -> None:
    """List every key of a scenario with its value, unit, range and meaning.

    Change a key with --set KEY=VALUE. A key that ends with [] belongs to a list of tables.
    """
    from scenarios import part_listing

    matches = [key for key in part_listing.keys(scenario) if find.lower() in f"{key.name} {key.meaning}".lower()]
    if as_json:
        typer.echo(json.dumps([asdict(key) for key in matches], indent=2, ensure_ascii=False))
        return
    table = _table("key", "default" if scenario is None else "value", "range", "meaning")
    for key in matches:
        table.add_row(key.name, _value(key), key.range, key.meaning)
    PlainConsole().print(table)


def _table(*columns: str, title: str | None = None) -> Table:
    """A table without lines whose first column is never broken."""
    table = Table(box=None, pad_edge=False, title=title, title_justify="left", title_style="bold")
    for k, column in enumerate(columns):
        table.add_column(column, overflow="fold", no_wrap=k == 0)
    return table


def _value(key: "Key") -> str:
    return key.default if key.unit == "-" else f"{key.default} {key.unit}"
