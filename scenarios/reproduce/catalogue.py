"""Catalogue of the tables and figures that can be reproduced."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Final

from scenarios.progress import Progress
from scenarios.reproduce.figure import Reproduction
from vehicle.parameter_file import nearest

Maker = Callable[[bool, Progress], Reproduction]  # arguments: quick (fewer images), and the progress callback

REPRODUCTIONS: Final = {
    "reina2008-table2": "scenarios.reproduce.reina2008_sample:table2",
    "reina2008-fig6": "scenarios.reproduce.reina2008_sample:fig6",
    "reina2008-table3": "scenarios.reproduce.reina2008_table3:table3",
    "reina2008-table3-plus": "scenarios.reproduce.reina2008_table3:table3_plus",
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
    """Names of the selected tables and figures: this one, or every one with ``all``.

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
    """Import the function that reproduces a table or figure."""
    module, _, function = REPRODUCTIONS[name].partition(":")
    result: Maker = getattr(importlib.import_module(module), function)
    return result
