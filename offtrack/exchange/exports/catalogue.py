"""Formats that finished runs are written in, by name. A new format is one module and one line here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final, Protocol

from scenarios.catalogue import Catalogue
from scenarios.progress import Progress, no_progress
from scenarios.results.log import Log

EXPORT: Final = Catalogue(
    {
        "csv": "offtrack.exchange.exports.log_files:Csv",
        "mat": "offtrack.exchange.exports.log_files:Mat",
        "mf4": "offtrack.exchange.exports.log_files:Mf4",
        "mcap": "offtrack.exchange.exports.mcap:Mcap",
        "rosbag2": "offtrack.exchange.exports.rosbag2:Rosbag2",
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
