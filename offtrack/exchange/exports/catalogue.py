"""Formats that finished runs are written in, by name, and logs in SI units as CSV, MATLAB's MAT and ASAM's MF4.

A new format is one module and one line here.
"""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol

import numpy as np

from scenarios.catalogue import Catalogue
from scenarios.extras import import_extra
from scenarios.progress import Progress, no_progress
from scenarios.results.log import Log
from scenarios.results.run_directory import check_new_file, replacing

EXPORT: Final = Catalogue(
    {
        "csv": "offtrack.exchange.exports.catalogue:Csv",
        "mat": "offtrack.exchange.exports.catalogue:Mat",
        "mf4": "offtrack.exchange.exports.catalogue:Mf4",
        "mcap": "offtrack.exchange.exports.message_files:Mcap",
        "rosbag2": "offtrack.exchange.exports.message_files:Rosbag2",
    },
    methods=("write",),
    declares=("file", "takes_images"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedRun:
    """A finished run to write."""

    log: Log
    scenario: Path
    images: Path | None = None  # the recording that the same run made
    progress: Progress = no_progress


class ExportFormat(Protocol):
    """A format of signals with their units and meanings."""

    file: ClassVar[str]  # name of the file or folder, in the run's directory if no other is given
    takes_images: ClassVar[bool]

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write a run; return the files.

        Raises:
            ValueError: one line, if a file exists, a package is missing, or the run does not fit the format.
        """


_TIME: Final = "time"
_LONGEST: Final = 63  # characters of a name in MATLAB


class Csv:
    """A row of names and a row for each 10 ms, empty where a signal has no value.

    Units and meanings are in a second table, whose name ends with ``.units.csv``.
    """

    file: ClassVar = "signals.csv"
    takes_images: ClassVar = False

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write both tables."""
        log, units = run.log, path.with_suffix(".units.csv")
        for file in (path, units):
            check_new_file(file)
        values = (["" if np.isnan(value) else repr(float(value)) for value in row] for row in log.rows)
        _write_table(path, log.names, values)
        _write_table(units, ("name", "unit", "meaning"), ((one.name, one.unit, one.description) for one in log.signals))
        return path, units


def _write_table(path: Path, names: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)


class Mat:
    """MAT of version 5 with structures ``signals``, ``units`` and ``meanings``; their fields are the signals' names."""

    file: ClassVar = "signals.mat"
    takes_images: ClassVar = False

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file."""
        from scipy.io import savemat

        check_new_file(path)
        log = run.log
        for name in log.names:
            if len(name) > _LONGEST or not name.isidentifier():
                raise ValueError(
                    f"signal '{name}' has no name for MATLAB: must be letters, digits and _, at most {_LONGEST} of "
                    "them; csv takes any name"
                )
        content: dict[str, Any] = {
            "signals": {name: log[name][:, None] for name in log.names},
            "units": {signal.name: signal.unit for signal in log.signals},
            "meanings": {signal.name: signal.description for signal in log.signals},
        }
        with replacing(path) as unfinished:
            savemat(str(unfinished), content, appendmat=False, long_field_names=True, do_compression=True)
        return (path,)


class Mf4:
    """MF4 of version 4.10 with a channel for each signal over its time, with unit and comment."""

    file: ClassVar = "signals.mf4"
    takes_images: ClassVar = False

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file."""
        check_new_file(path)
        asammdf = import_extra("export", "MF4 needs", "asammdf")
        time = np.ascontiguousarray(run.log[_TIME])
        channels = [
            asammdf.Signal(
                samples=np.ascontiguousarray(run.log[signal.name]),
                timestamps=time,
                name=signal.name,
                unit=signal.unit,
                comment=signal.description,
            )
            for signal in run.log.signals
            if signal.name != _TIME
        ]
        with asammdf.MDF(version="4.10") as file, replacing(path) as unfinished, unfinished.open("wb") as out:
            file.append(channels, comment="offtrack")
            file.save(out, overwrite=True)
        return (path,)
