"""`offtrack scenarios`, `parts` and `keys`: list what there is to choose."""

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer
from rich.padding import Padding

from offtrack.commands.console import AsJson, PlainConsole, listing
from scenarios.options.shipped import scenario_names, shipped_table
from vehicle.foundation.user_file import nearest, shown

if TYPE_CHECKING:
    from scenarios.part_listing import Key

PARTS_EXAMPLES = (
    "Examples: offtrack parts   offtrack parts trailer_steering   offtrack parts trailer_steering mpc   "
    "offtrack parts fault --json"
)
KEYS_EXAMPLES = (
    "Examples: offtrack keys roundabout   offtrack keys roundabout surface.friction   offtrack keys wind   "
    "offtrack keys roundabout --find sun"
)
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
    name: Annotated[str | None, typer.Argument(help="A part to show with its parameters.", show_default=False)] = None,
    find: Find = "",
    as_json: AsJson = False,
) -> None:
    """List the replaceable parts; show one with its parameters, defaults, units and ranges.

    Choose a part with --set KEY=NAME, or your own with --set KEY=package.module:Name.
    """
    from scenarios import part_listing

    if kind is not None and name is None and kind not in part_listing.KINDS:
        named = [part for part in part_listing.parts() if part.name == kind]
        matches = named or part_listing.parts(kind)  # which refuses it
    else:
        matches = [part for part in part_listing.parts(kind) if name in (None, part.name)]
        if not matches:
            known = [part.name for part in part_listing.parts(kind)]
            raise ValueError(f"{kind} has no part '{shown(str(name))}'{nearest(str(name), known)}")
    matches = [part for part in matches if find.lower() in f"{part.name} {part.meaning}".lower()]
    if as_json:
        typer.echo(json.dumps([asdict(part) for part in matches], indent=2, ensure_ascii=False))
        return
    console = PlainConsole()
    is_long = len({part.name for part in matches}) == 1 or bool(find)
    for heading in dict.fromkeys(part.kind for part in matches):
        console.print(heading, style="bold")
        listed = [part for part in matches if part.kind == heading]
        width = max(len(part.name) for part in listed)
        for part in listed:
            if not is_long:
                _print_line(console, f"  {part.name:{width}}  {part.meaning}")
                continue
            _print_text(console, f"{part.name}: {part.meaning}", 2)
            for key in part.parameters:
                _print_key(console, key, 4)
    if not is_long:
        console.print("Parameters of one: offtrack parts KIND NAME")


def keys(
    scenario: Annotated[
        str | None,
        typer.Argument(help="Scenario whose values are shown as defaults; all keys of trailer scenarios if not given."),
    ] = None,
    key: Annotated[
        str | None, typer.Argument(help="A key, or the beginning of keys, to show in full.", show_default=False)
    ] = None,
    find: Find = "",
    as_json: AsJson = False,
) -> None:
    """List every key of a scenario with its value; show one with unit, range and meaning.

    Change a key with --set KEY=VALUE. A key that ends with [] belongs to a list of tables.
    """
    from scenarios import part_listing

    if scenario is not None and key is None and not scenario.endswith(".toml") and scenario not in scenario_names():
        every = part_listing.keys()
        if any(_is_of(one.name, scenario) for one in every):
            scenario, key = None, scenario
    every = part_listing.keys(scenario)
    matches = [one for one in every if find.lower() in f"{one.name} {one.meaning}".lower()]
    if key is not None:
        matches = [one for one in matches if _is_of(one.name, key)]
        if not matches:
            raise ValueError(f"no key '{shown(key)}'{nearest(key, [one.name for one in every])}")
    if as_json:
        typer.echo(json.dumps([asdict(one) for one in matches], indent=2, ensure_ascii=False))
        return
    console = PlainConsole()
    if key is not None or find:
        for one in matches:
            _print_key(console, one, 0)
        return
    width = min(32, max(len(one.name) for one in matches))
    for one in matches:
        _print_line(console, f"{one.name:{width}} {_value(one):14} {one.meaning}")
    console.print(f"One in full: offtrack keys {scenario or 'SCENARIO'} KEY", soft_wrap=True)


def _is_of(name: str, key: str) -> bool:
    """True if a key's name is this one, or in the table of this name."""
    return name == key or name.startswith((f"{key}.", f"{key}[]"))


def _print_line(console: PlainConsole, line: str) -> None:
    """Print a line, cut at the width of the terminal."""
    console.print(line, no_wrap=True, overflow="ellipsis", crop=True)


def _print_text(console: PlainConsole, text: str, indent: int) -> None:
    console.print(Padding(text, (0, 0, 0, indent)))


def _print_key(console: PlainConsole, key: "Key", indent: int) -> None:
    """Print a key with value, unit and range, and its meaning below."""
    limits = f"   ({key.range})" if key.range else ""
    _print_text(console, f"{key.name} = {_value(key)}{limits}", indent)
    _print_text(console, key.meaning, indent + 4)


def _value(key: "Key") -> str:
    return key.default if key.unit == "-" or key.default in ("none", "required") else f"{key.default} {key.unit}"
