"""Logs as tables: CSV, workbooks of Excel and other spreadsheets, MATLAB's MAT of version 5, and ASAM's MF4."""

import csv
import math
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from offtrack.exchange.exports.catalogue import TIME, ExportedRun, by_rows, plain_names
from scenarios.extras import import_extra
from scenarios.results.run_directory import check_new_file, replacing


class Csv:
    """A row of names and a row for each 10 ms, empty where a signal has no value.

    Units and meanings are in a second table, whose name ends with ``.units.csv``. With a decimal comma cells are
    separated by semicolons, and the text begins with a byte order mark, as spreadsheets expect it.
    """

    file: ClassVar = "signals.csv"
    takes_images: ClassVar = False

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write both tables."""
        log, units = run.log, path.with_suffix(".units.csv")
        for file in (path, units):
            check_new_file(file)
        values = (
            ["" if np.isnan(value) else repr(value).replace(".", run.decimal) for value in row.tolist()]
            for row in log.rows
        )
        _write_table(path, log.names, values, run.decimal)
        meanings = ((one.name, one.unit, one.description) for one in log.signals)
        _write_table(units, ("name", "unit", "meaning"), meanings, run.decimal)
        return path, units


def _write_table(path: Path, names: Iterable[str], rows: Iterable[Iterable[str]], decimal: str) -> None:
    encoding, separator = ("utf-8-sig", ";") if decimal == "," else ("utf-8", ",")
    with replacing(path) as unfinished, unfinished.open("w", encoding=encoding, newline="") as file:
        writer = csv.writer(file, delimiter=separator, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)


_MOST_ROWS: Final = 1_048_575  # below the row of names
_CREATED: Final = datetime(2000, 1, 1)  # in every file: the same run gives the same bytes


class _Exact(float):
    """A number that is written with all its digits, not with the 16 of XlsxWriter."""

    def __format__(self, _: str) -> str:
        return repr(float(self))


class Xlsx:
    """A workbook with a sheet ``signals`` as in CSV, and a sheet ``units`` with units and meanings."""

    file: ClassVar = "signals.xlsx"
    takes_images: ClassVar = False

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file."""
        check_new_file(path)
        xlsxwriter = import_extra("export", "xlsx needs", "xlsxwriter")
        log = run.log
        if len(log) > _MOST_ROWS:
            raise ValueError(f"{len(log)} rows: a sheet has at most {_MOST_ROWS}; csv and mat take any number")
        with replacing(path) as unfinished, xlsxwriter.Workbook(str(unfinished), {"constant_memory": True}) as book:
            book.set_properties({"created": _CREATED})
            sheet = book.add_worksheet("signals")
            _write_texts(sheet, 0, log.names)
            sheet.freeze_panes(1, 0)
            for k, row in enumerate(log.rows, start=1):
                for column, value in enumerate(row.tolist()):
                    if math.isfinite(value):
                        sheet.write_number(k, column, _Exact(value))
            sheet = book.add_worksheet("units")
            meanings = ((one.name, one.unit, one.description) for one in log.signals)
            for k, texts in enumerate((("name", "unit", "meaning"), *meanings)):
                _write_texts(sheet, k, texts)
        return (path,)


def _write_texts(sheet: Any, row: int, texts: tuple[str, ...]) -> None:
    for column, text in enumerate(texts):
        sheet.write_string(row, column, text)


_LONGEST: Final = 63  # characters of a name in MATLAB
_HEADER: Final = b"MATLAB 5.0 MAT-file, written by offtrack".ljust(116)  # in place of scipy's, which has the time


class Mat:
    """Structures ``signals``, ``units``, ``meanings`` and ``names``, whose fields are the signals' names made plain.

    ``names`` holds the original ones. Signals have a row for each 10 ms. Those without a value in some rows are also in
    the structure ``sampled``: each with ``time`` and ``value`` where it has one.
    """

    file: ClassVar = "signals.mat"
    takes_images: ClassVar = False

    @staticmethod
    def write(run: ExportedRun, path: Path) -> tuple[Path, ...]:
        """Write the file."""
        from scipy.io import savemat

        check_new_file(path)
        log, plain = run.log, plain_names(run.log.names, _LONGEST)
        content: dict[str, Any] = {
            "signals": {plain[name]: log[name][:, None] for name in log.names},
            "units": {plain[signal.name]: signal.unit for signal in log.signals},
            "meanings": {plain[signal.name]: signal.description for signal in log.signals},
            "names": {plain[name]: name for name in log.names},
            "sampled": {
                plain[name]: {TIME: log[TIME][rows, None], "value": log[name][rows, None]}
                for rows, names in by_rows(log)
                for name in names
                if not rows.all()
            },
        }
        with replacing(path) as unfinished:
            savemat(str(unfinished), content, appendmat=False, long_field_names=True, do_compression=True)
            with unfinished.open("r+b") as file:
                file.write(_HEADER)
        return (path,)


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
