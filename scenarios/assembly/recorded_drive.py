"""Read a recorded drive from a CSV file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from controllers.driver_trace import DriverTrace
from vehicle.frames import FloatArray
from vehicle.parameter_file import nearest
from vehicle.table_file import Column, open_table

_COLUMNS: Final = {  # with the factor to SI; the limits are beyond any lorry, wrong units exceed them
    "time_s": (Column("time_s", 86_400.0, "s"), 1.0),
    "steer_deg": (Column("steer_deg", 90.0, "deg"), math.pi / 180.0),
    "speed_kmh": (Column("speed_kmh", 200.0, "km/h"), 1.0 / 3.6),
    "acceleration": (Column("acceleration", 20.0, "m/s2"), 1.0),
}


def read_trace(path: Path) -> DriverTrace:
    """Read a drive; the first line names the columns time_s, steer_deg, and speed_kmh or acceleration [m/s2].

    Raises:
        ValueError: one line naming file, column, line and limit.
    """
    try:
        table = open_table(path)
    except ValueError as error:
        raise ValueError(f"driver.trace: {error}") from error
    _check(path, table.names)
    numbers = table.numbers([_COLUMNS[name][0] for name in table.names])
    columns: dict[str, FloatArray] = {
        name: _COLUMNS[name][1] * values for name, values in zip(table.names, numbers.T, strict=True)
    }
    try:
        return DriverTrace(
            time=columns["time_s"],
            steer=columns["steer_deg"],
            speed=columns.get("speed_kmh"),
            acceleration=columns.get("acceleration"),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _check(path: Path, names: list[str]) -> None:
    for name in names:
        if name not in _COLUMNS:
            raise ValueError(f"{path}: unknown column '{name}'{nearest(name, _COLUMNS)}")
    for name in ("time_s", "steer_deg"):
        if name not in names:
            raise ValueError(f"{path}: column '{name}' is missing")
    if not {"speed_kmh", "acceleration"} & set(names):
        raise ValueError(f"{path}: a column 'speed_kmh' or 'acceleration' is missing")
