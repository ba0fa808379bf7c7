"""Read a recorded drive from a CSV file."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from controllers.driver_trace import DriverTrace
from vehicle.frames import FloatArray
from vehicle.parameter_file import nearest

_COLUMNS = {"time_s": 1.0, "steer_deg": math.pi / 180.0, "speed_kmh": 1.0 / 3.6, "acceleration": 1.0}  # to SI
_NEEDED = ("time_s", "steer_deg")


def read_trace(path: Path) -> DriverTrace:
    """Read a drive; the first line names the columns time_s, steer_deg, and speed_kmh or acceleration [m/s2].

    Raises:
        ValueError: one line naming file, column and line.
    """
    if not path.is_file():
        raise ValueError(f"driver.trace: there is no file {path}")
    with path.open(newline="", encoding="utf-8-sig") as file:
        lines = [line for line in csv.reader(file) if line]
    names = [name.strip() for name in lines[0]] if lines else []
    _check(path, names)
    table = np.array([_numbers(path, k, names, line) for k, line in enumerate(lines[1:], start=2)])
    columns: dict[str, FloatArray] = {
        name: _COLUMNS[name] * values for name, values in zip(names, table.T, strict=False)
    }
    try:
        return DriverTrace(
            time=columns.get("time_s", np.empty(0)),
            steer=columns.get("steer_deg", np.empty(0)),
            speed=columns.get("speed_kmh"),
            acceleration=columns.get("acceleration"),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _check(path: Path, names: list[str]) -> None:
    for name in names:
        if name not in _COLUMNS:
            raise ValueError(f"{path}: unknown column '{name}'{nearest(name, _COLUMNS)}")
    for name in _NEEDED:
        if name not in names:
            raise ValueError(f"{path}: column '{name}' is missing")
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: two columns have the same name")
    if not {"speed_kmh", "acceleration"} & set(names):
        raise ValueError(f"{path}: a column 'speed_kmh' or 'acceleration' is missing")


def _numbers(path: Path, k: int, names: list[str], line: list[str]) -> list[float]:
    if len(line) != len(names):
        raise ValueError(f"{path}: line {k} has {len(line)} values for {len(names)} columns")
    for name, text in zip(names, line, strict=True):
        if not _is_finite(text):
            raise ValueError(f"{path}: line {k}: {name} = '{text.strip()}' is not a finite number")
    return [float(text) for text in line]


def _is_finite(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
