"""A reproduced table or figure: own and published numbers, data and a picture; and the catalogue of all."""

import hashlib
import importlib
import json
import math
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import matplotlib
from matplotlib.figure import Figure

from offtrack.reports.plots import STYLE
from offtrack.studies.case import software
from scenarios.progress import Progress, postponed_interrupts
from scenarios.results.log import Log, write_log
from scenarios.results.run_directory import appearing_at_once, mark_interrupted
from scenarios.results.run_summary import versions
from vehicle.foundation.user_file import nearest

_DPI: Final = 150


@dataclass(frozen=True, slots=True)
class Comparison:
    """A published number and its reproduction."""

    quantity: str
    published: str  # as printed; "" if the paper has no such number
    own: float
    unit: str = "m"

    @property
    def own_text(self) -> str:
        """Own number as text."""
        if not math.isfinite(self.own):
            return "–"
        return f"{self.own:.0f}" if abs(self.own) >= 100.0 else f"{self.own:.3g}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reproduction:
    """Result of a reproduction."""

    name: str
    title: str
    source: str
    comparisons: Sequence[Comparison]
    notes: Sequence[str]  # definitions, and differences from the paper's experiment
    data: Log
    draw: Callable[[], Figure]  # called with the project's matplotlib style
    interrupted: bool = False  # True if it is incomplete

    def as_plain(self) -> dict[str, Any]:
        """Contents for JSON; null where a number could not be measured."""
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "notes": list(self.notes),
            "interrupted": self.interrupted,
            "numbers": [
                {
                    "quantity": one.quantity,
                    "published": one.published or None,
                    "own": one.own if math.isfinite(one.own) else None,
                    "unit": one.unit,
                }
                for one in self.comparisons
            ],
        }


@cache
def printed(paper: str) -> dict[str, Any]:
    """Titles, notes and numbers of a paper's figures and tables, by their names."""
    return tomllib.loads((files("offtrack.studies.reproduce") / f"{paper}.toml").read_text(encoding="utf-8"))


def reproduced(
    name: str,
    comparisons: Iterable[Comparison],
    data: Log,
    draw: Callable[[], Figure],
    *,
    finished: tuple[int, int] = (1, 1),
    parts: str = "",
) -> Reproduction:
    """A table or figure of a paper; ``finished``: number of its ``parts`` that are finished, and of all."""
    paper, _, figure = name.partition("-")
    table, texts, (done, of) = printed(paper)[figure], printed(paper)["notes"], finished
    missing = [f"Interrupted: {done} of {of} {parts} are finished; the others are missing here."] if done < of else []
    return Reproduction(
        name=name,
        title=table["title"],
        source=printed(paper)["source"],
        comparisons=list(comparisons),
        notes=(*(texts[key] for key in table["notes"]), *missing),
        data=data,
        draw=draw,
        interrupted=done < of,
    )


def earlier_reproduction(name: str, directory: Path, settings: Mapping[str, Any]) -> dict[str, Any] | None:
    """Contents for JSON of a finished reproduction with these settings and this software; None if there is none."""
    try:
        content: dict[str, Any] = json.loads((directory / f"{name}.json").read_text(encoding="utf-8"))
        wanted = _with_software(settings)
        same = not content["interrupted"] and all(content[key] == value for key, value in wanted.items())
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return content if same else None


def _with_software(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {**settings, "versions": versions(), "software": hashlib.sha256("".join(software()).encode()).hexdigest()}


def write_reproduction(reproduction: Reproduction, directory: Path, settings: Mapping[str, Any]) -> None:
    """Write picture (PNG), data (Parquet) and numbers with settings (JSON): all of them or nothing.

    Raises:
        ValueError: if the directory exists and is not empty.
    """
    with postponed_interrupts(), appearing_at_once(directory) as folder:
        with matplotlib.rc_context(STYLE):
            reproduction.draw().savefig(folder / f"{reproduction.name}.png", dpi=_DPI)
        write_log(reproduction.data, folder / f"{reproduction.name}.parquet")
        content = {**reproduction.as_plain(), **_with_software(settings)}
        text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
        (folder / f"{reproduction.name}.json").write_text(text + "\n", encoding="utf-8")
        if reproduction.interrupted:
            mark_interrupted(folder)


Maker = Callable[[bool, Progress], Reproduction]  # arguments: quick (fewer images), and the progress callback

REPRODUCTIONS: Final = {
    "reina2008-table2": "offtrack.studies.reproduce.reina2008_figures:table2",
    "reina2008-fig6": "offtrack.studies.reproduce.reina2008_figures:fig6",
    "reina2008-table3": "offtrack.studies.reproduce.trace_tables:table3",
    "reina2008-table3-plus": "offtrack.studies.reproduce.trace_tables:table3_plus",
    "reina2008-fig8": "offtrack.studies.reproduce.reina2008_figures:fig8",
    "desaxe2018-fig6": "offtrack.studies.reproduce.desaxe2018:fig6",
    "desaxe2018-fig7": "offtrack.studies.reproduce.desaxe2018:fig7",
    "desaxe2018-fig8": "offtrack.studies.reproduce.desaxe2018:fig8",
    "desaxe2018-fig9": "offtrack.studies.reproduce.desaxe2018:fig9",
    "desaxe2018-fig13": "offtrack.studies.reproduce.desaxe2018_field:fig13",
    "desaxe2018-fig14": "offtrack.studies.reproduce.desaxe2018_field:fig14",
    "desaxe2018-fig15": "offtrack.studies.reproduce.desaxe2018_field:fig15",
    "desaxe2018-fig16": "offtrack.studies.reproduce.desaxe2018_field:fig16",
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
