"""Data sheet of a vehicle or a rover: numbers, tables and a drawing to scale."""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from scenarios.results.run_directory import appearing_at_once
from scenarios.vehicle_sheet.paper import SheetTable, save_sheet
from vehicle.combination.description import load_vehicle, vehicle_names
from vehicle.parameter_file import read_toml
from vehicle.rover.description import load_rover, rover_names


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


def known_vehicles() -> dict[str, dict[str, str]]:
    """Summaries of the shipped vehicles and rovers by kind and name."""
    return {
        "vehicles": {name: load_vehicle(name).summary for name in vehicle_names()},
        "rovers": {name: load_rover(name).summary for name in rover_names()},
    }


def open_sheet(name_or_path: str) -> VehicleSheet:
    """Data sheet of a shipped vehicle or rover, or of one described by a ``.toml`` file.

    Raises:
        ValueError: one line naming file, key, value, limit and unit, or the nearest known name.
    """
    from scenarios.vehicle_sheet.combination_sheet import combination_sheet
    from scenarios.vehicle_sheet.rover_sheet import rover_sheet

    return rover_sheet(name_or_path) if _is_rover(name_or_path) else combination_sheet(name_or_path)


def _is_rover(name_or_path: str) -> bool:
    if name_or_path.endswith(".toml"):
        return "sinkage_limit" in read_toml(Path(name_or_path))
    vehicles, rovers = vehicle_names(), rover_names()
    if name_or_path not in (*vehicles, *rovers):
        close = difflib.get_close_matches(name_or_path, (*vehicles, *rovers), n=1, cutoff=0.5)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        raise ValueError(
            f"unknown vehicle or rover '{name_or_path}'{hint} (vehicles: {', '.join(vehicles)}; "
            f"rovers: {', '.join(rovers)}; or a .toml file)"
        )
    return name_or_path in rovers


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
