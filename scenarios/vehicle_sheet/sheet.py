"""Data sheet of a vehicle or a rover: numbers, tables and a drawing to scale."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from scenarios.results.run_directory import appearing_at_once
from scenarios.vehicle_sheet.paper import SheetTable, save_sheet


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleSheet:
    """Data sheet of one vehicle or rover."""

    name: str
    summary: str
    size: str  # mass and dimensions in words
    tables: tuple[SheetTable, ...]
    warnings: tuple[str, ...]
    note: str  # on the sources of the numbers
    numbers: dict[str, object]  # ready for JSON
    draw: Callable[[], Figure]


def write_sheet(sheet: VehicleSheet, directory: Path) -> None:
    """Write sheet.svg, sheet.png and facts.json into a new directory."""
    with appearing_at_once(directory) as folder:
        save_sheet(sheet.draw, folder)
        (folder / "facts.json").write_text(json.dumps(sheet.numbers, indent=2) + "\n", encoding="utf-8")


def sources_note(sources: dict[str, str]) -> tuple[str, dict[str, int]]:
    """Number of values that state a source, in words and for JSON."""
    assumed = sum(source.startswith("assumed") for source in sources.values())
    return (
        f"{len(sources)} numbers of the file state their source, {assumed} of them as assumed",
        {"stated": len(sources), "assumed": assumed},
    )
