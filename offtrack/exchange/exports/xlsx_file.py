"""Logs as workbooks of Excel and other spreadsheets, written by XlsxWriter."""

import math
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar, Final

from offtrack.exchange.exports.catalogue import ExportedRun
from scenarios.extras import import_extra
from scenarios.results.run_directory import check_new_file, replacing

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
