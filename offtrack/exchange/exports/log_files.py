"""Writers of a log: CSV, MATLAB's MAT and ASAM's MF4."""

from __future__ import annotations

import csv
import importlib.util
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from scenarios.results.atomic_files import check_new_file, replacing
from scenarios.results.log import Log

Format = Literal["csv", "mat", "mf4"]
_TIME: Final = "time"
_LONGEST: Final = 63  # characters of a name in MATLAB


def written(log: Log, path: Path, kind: Format) -> tuple[Path, ...]:
    """Write a log in SI units with units and meanings of its signals; return the files.

    - CSV has a row of names and a row for each 10 ms, empty where a signal has no value. Units and meanings are in a
      second table, whose name ends with ``.units.csv``.
    - MAT (version 5) has structures ``signals``, ``units`` and ``meanings``, whose fields are the signals' names.
    - MF4 (version 4.10) has a channel for each signal over its time, with unit and comment.

    Raises:
        ValueError: one line, if a file exists, a package is missing, or a name does not fit the format.
    """
    units = path.with_suffix(".units.csv")
    for file in (path, units) if kind == "csv" else (path,):
        check_new_file(file)
    if kind == "mf4" and importlib.util.find_spec("asammdf") is None:
        raise ValueError("MF4 needs the extra 'export': pip install 'offtrack[export]'")
    if kind == "csv":
        _write_csv(log, path)
        _write_units(log, units)
        return path, units
    with replacing(path) as unfinished:
        if kind == "mat":
            _write_mat(log, unfinished)
        else:
            _write_mf4(log, unfinished)
    return (path,)


def _write_csv(log: Log, path: Path) -> None:
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(log.names)
        for row in log.rows:
            writer.writerow(["" if np.isnan(value) else repr(float(value)) for value in row])


def _write_units(log: Log, path: Path) -> None:
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("name", "unit", "meaning"))
        writer.writerows((signal.name, signal.unit, signal.description) for signal in log.signals)


def _write_mat(log: Log, path: Path) -> None:
    from scipy.io import savemat

    for name in log.names:
        if len(name) > _LONGEST or not name.isidentifier():
            raise ValueError(
                f"signal '{name}' has no name for MATLAB: must be letters, digits and _, at most {_LONGEST} of them; "
                "csv takes any name"
            )
    content: dict[str, Any] = {
        "signals": {name: log[name][:, None] for name in log.names},
        "units": {signal.name: signal.unit for signal in log.signals},
        "meanings": {signal.name: signal.description for signal in log.signals},
    }
    savemat(str(path), content, appendmat=False, long_field_names=True, do_compression=True)


def _write_mf4(log: Log, path: Path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append(
            [
                Signal(
                    samples=np.ascontiguousarray(log[signal.name]),
                    timestamps=np.ascontiguousarray(log[_TIME]),
                    name=signal.name,
                    unit=signal.unit,
                    comment=signal.description,
                )
                for signal in log.signals
                if signal.name != _TIME
            ],
            comment="offtrack",
        )
        with path.open("wb") as out:
            file.save(out, overwrite=True)
