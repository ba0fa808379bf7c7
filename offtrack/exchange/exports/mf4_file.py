"""Logs as ASAM's MF4 files, written by asammdf."""

from datetime import UTC, datetime
from pathlib import Path
from typing import ClassVar, Final

from offtrack.exchange.exports.catalogue import TIME, ExportedRun, by_rows
from scenarios.extras import import_extra
from scenarios.results.run_directory import check_new_file, replacing

_TIME_OF_HISTORY: Final = 40  # place of the time in a block of the file's history


class Mf4:
    """MF4 of version 4.10 with a channel for each signal over its time, with unit and comment.

    Signals that have their values at the same times are a channel group; those without any are NaN.
    """

    file: ClassVar = "signals.mf4"
    takes_images: ClassVar = False

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file."""
        check_new_file(path)
        asammdf = import_extra("export", "MF4 needs", "asammdf")
        signals = {signal.name: signal for signal in run.log.signals}
        with asammdf.MDF(version="4.10") as file, replacing(path) as unfinished, unfinished.open("wb") as out:
            for rows, names in by_rows(run.log):
                channels = [
                    asammdf.Signal(
                        samples=run.log[name][rows],
                        timestamps=run.log[TIME][rows],
                        name=name,
                        unit=signals[name].unit,
                        comment=signals[name].description,
                    )
                    for name in names
                ]
                file.append(channels, comment="offtrack")
            file.header.start_time = datetime.fromtimestamp(0, UTC)  # not now: the same run gives the same bytes
            file.save(out, overwrite=True)
            for block in file.file_history:
                out.seek(block.address + _TIME_OF_HISTORY)
                out.write(bytes(12))  # time and offsets of its zone
        return (path,)
