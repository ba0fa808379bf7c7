"""The tables and figures that can be made again, by name."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Final

from scenarios.progress import Progress
from scenarios.reproduce.figure import Reproduction
from vehicle.parameter_file import nearest

Maker = Callable[[bool, Progress], Reproduction]  # quick: fewer images, and the progress to tell

REPRODUCTIONS: Final = {
    "reina2008-table2": "scenarios.reproduce.reina2008_sample:table2",
    "reina2008-fig6": "scenarios.reproduce.reina2008_sample:fig6",
    "reina2008-table3": "scenarios.reproduce.reina2008_rates:table3",
    "reina2008-table3-plus": "scenarios.reproduce.reina2008_tracker:table3_plus",
    "reina2008-fig8": "scenarios.reproduce.reina2008_slope:fig8",
    "desaxe2018-fig6": "scenarios.reproduce.desaxe2018_simulation:fig6",
    "desaxe2018-fig7": "scenarios.reproduce.desaxe2018_simulation:fig7",
    "desaxe2018-fig8": "scenarios.reproduce.desaxe2018_simulation:fig8",
    "desaxe2018-fig9": "scenarios.reproduce.desaxe2018_drift:fig9",
    "desaxe2018-fig13": "scenarios.reproduce.desaxe2018_views:fig13",
    "desaxe2018-fig14": "scenarios.reproduce.desaxe2018_field:fig14",
    "desaxe2018-fig15": "scenarios.reproduce.desaxe2018_field:fig15",
    "desaxe2018-fig16": "scenarios.reproduce.desaxe2018_field:fig16",
}


def names_of(name: str) -> tuple[str, ...]:
    """The one of that name, or with ``all`` every one.

    Raises:
        ValueError: one line, naming the nearest known name.
    """
    if name == "all":
        return tuple(REPRODUCTIONS)
    if name not in REPRODUCTIONS:
        known = tuple(REPRODUCTIONS)
        raise ValueError(f"unknown figure '{name}'{nearest(name, known)} (known: all, {', '.join(known)})")
    return (name,)


def maker(name: str) -> Maker:
    """The function that makes a table or figure again; imported only now."""
    module, _, function = REPRODUCTIONS[name].partition(":")
    made: Maker = getattr(importlib.import_module(module), function)
    return made
