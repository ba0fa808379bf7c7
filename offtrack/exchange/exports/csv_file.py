"""Logs as CSV."""

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import numpy as np

from offtrack.exchange.exports.catalogue import ExportedRun
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
