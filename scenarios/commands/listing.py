"""`offtrack scenarios`: what there is to run."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from scenarios.options.scenario import load_any_scenario, scenario_names


def scenarios() -> None:
    """List the scenarios, a line each. Run one with: offtrack run NAME."""
    table = Table(box=None, show_header=False, pad_edge=False)
    for name in scenario_names():
        table.add_row(name, load_any_scenario(name).description)
    Console().print(table)
