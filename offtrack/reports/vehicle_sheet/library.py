"""Data sheets of vehicles and rovers by name."""

from __future__ import annotations

import difflib
from pathlib import Path

from offtrack.reports.vehicle_sheet.combination_sheet import combination_sheet
from offtrack.reports.vehicle_sheet.rover_sheet import rover_sheet
from offtrack.reports.vehicle_sheet.sheet import VehicleSheet
from vehicle.combination.description import load_vehicle, vehicle_names
from vehicle.foundation.user_file import read_toml
from vehicle.rover.description import load_rover, rover_names


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
    return rover_sheet(name_or_path) if is_rover(name_or_path) else combination_sheet(name_or_path)


def is_rover(name_or_path: str) -> bool:
    """True for a rover, False for a combination.

    Raises:
        ValueError: one line, if it is no name of one and no ``.toml`` file that can be read.
    """
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
