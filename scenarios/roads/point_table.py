"""Read the points of a path from a table as text, as spreadsheets, loggers and programs write it.

The separator is the first of tab, semicolon, comma, bar and space that all lines have. Point or comma is the decimal
sign, whichever all numbers of the table allow; the other one, spaces and apostrophes may group digits by threes.
"""

import csv
import io
import re
from array import array
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from vehicle.foundation.data_file import Column
from vehicle.foundation.user_file import MAX_FIELD, MAX_POINTS, MAX_TABLE, FileKind, nearest, read_bytes, shown
from vehicle.frames import FloatArray

LATITUDE, LONGITUDE = Column("latitude", 90.0, "deg"), Column("longitude", 180.0, "deg")
HEIGHT: Final = Column("elevation", 1e4, "m")
EAST, NORTH = Column("easting", 1e8, "m"), Column("northing", 1e8, "m")  # any projected coordinates of the earth
_COLUMNS: Final = {
    "x": EAST,
    "y": NORTH,
    "lat": LATITUDE,
    "lon": LONGITUDE,
    "z": HEIGHT,
    "bank": Column("bank", 0.2, "m/m"),  # a plane's limit, surface.cross_fall
    "left_width": Column("left_width", 100.0, "m"),
    "right_width": Column("right_width", 100.0, "m"),
    "friction": Column("friction", 1.5, "-"),
}
_OTHER_NAMES: Final = {  # without spaces, dots, dashes and underscores
    "x": "xcoord xcoordinate pointx utmx utme easting east e rechtswert",
    "y": "ycoord ycoordinate pointy utmy utmn northing north n hochwert",
    "lat": "latitude breite",
    "lon": "long lng longitude länge",
    "z": "zcoord height elevation elev ele altitude alt höhe",
}
_KNOWN: Final = {other: name for name, others in _OTHER_NAMES.items() for other in others.split()} | {
    name.replace("_", ""): name for name in _COLUMNS
}
_NOT_READ: Final = frozenset(  # columns of loggers and programs that say nothing of the road
    (
        *("", "id", "fid", "ogcfid", "objectid", "no", "nr", "number", "index", "point", "pointid", "name", "label"),
        *("comment", "remark", "description", "type", "time", "timestamp", "timeutc", "date", "datetime", "utc"),
        *("speed", "speedkmh", "course", "heading", "hdop", "sat", "satellites", "accuracy"),
        *("s", "station", "chainage", "distance", "dist"),
    )
)
_UNITS: Final = {
    "m": ("m", "meter", "meters", "metre", "metres"),
    "deg": ("deg", "°", "degree", "degrees", "dd"),
    "m/m": ("m/m", "-"),
    "-": ("-",),
}
_UNIT: Final = re.compile(r"(.*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])]|\s/\s*(\S+)|[ _](m|km|cm|mm|ft|deg))?")
_NUMBER: Final = re.compile(r"[-+\u2212]?[.,'\u2019\s]*+\d[\d.,'\u2019\s]*+(?:[eE][-+]?\d+)?")
_PLAIN: Final = re.compile(r"[^,'\u2019\s\u2212]*")
_GAP: Final = re.compile(r"(?<=\d)['\u2019\s](?=\d{3}(?!\d))")
_GROUPED: Final = {
    sign: re.compile(rf"[-+]?[1-9]\d{{0,2}}(?:\{group}\d{{3}})+(?:\{sign}\d*)?(?:[eE][-+]?\d+)?")
    for sign, group in (",.", ".,")
}
_LEVEL, _DECIMAL = "; course.heights = false drives it level", " (decimal degrees)"
_HINTS: Final = {"z": _LEVEL, "bank": _LEVEL, "lat": _DECIMAL, "lon": _DECIMAL}
_SEPARATORS: Final = {"\t": "tabs", ";": "semicolons", ",": "commas", "|": "bars", " ": "spaces"}
_LOOKED_AT: Final = 20  # lines that decide about the separator
_LONGEST: Final = 100  # characters of a column's name


class PointTable(NamedTuple):
    """Columns of numbers by their names here, and where they are from."""

    columns: Mapping[str, FloatArray]  # (n,) x and y [m], or lat and lon [deg], and others
    lines: FloatArray  # (n,) numbers of the lines in the file


class _Row(NamedTuple):
    line: int
    cells: list[str]


def read_points(path: Path, *, heights: bool) -> PointTable:
    """Points of a table, without z and bank if ``heights`` are not wanted.

    Raises:
        ValueError: one line naming file, line, column, value and limit.
    """
    rows, separator = _rows(path)
    if len(rows) > MAX_POINTS + 1:
        raise ValueError(f"{path}: has {len(rows)} points: a path must have 2 to {MAX_POINTS}")
    names = _names(path, rows, separator)
    _check_names(path, names)
    wanted = {name: k for name, k in names.items() if heights or name not in ("z", "bank")}
    decimal = _decimal(path, [(row.line, row.cells[k]) for row in rows for k in wanted.values()], separator)
    table: dict[str, FloatArray] = {}
    for name, k in wanted.items():
        column, numbers = _COLUMNS[name]._replace(name=name), array("d")
        hint = _HINTS.get(name, "")
        for row in rows:
            place = f"{path}: line {row.line}"
            try:
                numbers.append(column.number(_written(row.cells[k], decimal, place), place))
            except ValueError as error:
                raise ValueError(f"{error}{hint}") from None
        table[name] = np.array(numbers, dtype=np.float64)
    lines = np.array([row.line for row in rows], dtype=np.float64)
    for name, low in (("left_width", 0.0), ("right_width", 0.0), ("friction", 0.05)):
        if name in table and len(lines) and table[name].min() < low:
            k = int(np.argmin(table[name]))
            raise ValueError(f"{path}: line {lines[k]:.0f}: {name} = {table[name][k]:g} must be at least {low:g}")
    return PointTable(table, lines)


def _text(path: Path) -> str:
    content = read_bytes(path, FileKind.TABLE)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", errors="replace")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:  # of a spreadsheet; numbers are the same in all of these codes
        text = content.decode("cp1252", errors="replace")
    if "\0" in text:
        raise ValueError(f"{path}: not a text in UTF-8; save it as CSV in UTF-8")
    return text


def _rows(path: Path) -> tuple[list[_Row], str]:
    """Lines with values, the names of the columns first if there are any, and the separator."""
    text = _text(path)
    stated = re.match(r'"?sep=([;,|\t ])"?\r?\n', text, re.IGNORECASE)  # as spreadsheets write it
    sample = [line for line in text[:100_000].splitlines() if line.strip() and not line.startswith("#")][:_LOOKED_AT]
    separator = next((sign for sign in _SEPARATORS if sample and all(sign in line for line in sample)), ",")
    separator = stated[1] if stated else separator
    count = text.count(separator) + max(text.count("\n"), text.count("\r"))
    if count > MAX_TABLE:
        raise ValueError(f"{path} has some {count} numbers: {FileKind.TABLE.noun} must have at most {MAX_TABLE}")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
    rows: list[_Row] = []
    heading: _Row | None = None
    try:
        for line in reader:
            cells = [cell.strip() for cell in line if cell or separator != " "]
            if not any(cells) or (stated and reader.line_num == 1):  # spreadsheets leave lines empty
                continue
            if not cells[0].startswith("#"):
                rows.append(_Row(reader.line_num, cells))
            elif not rows:  # the last remark before the numbers may name their columns
                names = [cells[0].lstrip("# "), *cells[1:]]
                heading = _Row(reader.line_num, names if names[0] else names[1:])
    except csv.Error:
        raise ValueError(f"{path}: a value has more than {MAX_FIELD} characters; is a quotation mark open?") from None
    if heading and rows and _is_numbers(rows[0].cells) and len(heading.cells) == len(rows[0].cells):
        rows.insert(0, heading)
    return rows, separator


def _is_numbers(cells: Sequence[str]) -> bool:
    return all(_NUMBER.fullmatch(cell) for cell in cells if cell)


def _names(path: Path, rows: list[_Row], separator: str) -> dict[str, int]:
    """Numbers of the columns by their names here; the line with the names is taken from the rows."""
    if rows and not _is_numbers(rows[0].cells):
        heading = rows.pop(0).cells
        width, names = _used(heading), _named(path, heading, separator)
    else:
        width = max((_used(row.cells) for row in rows), default=0)
        counts = width == 3 and len(rows) > 2 and all(_counts(*pair) for pair in pairwise(rows))
        if rows and (width not in (2, 3) or counts):
            reason = "its first column counts the lines" if counts else f"it has {width} columns"
            raise ValueError(f"{path}: line {rows[0].line} names no columns and {reason}: name them, such as x,y,z")
        names = dict(zip(("x", "y", "z"), range(width), strict=False))
    for row in rows:
        if max(names.values(), default=-1) >= len(row.cells) or _used(row.cells) > width:
            hint = " (with a comma as decimal sign, separate the columns by semicolons)" if separator == "," else ""
            raise ValueError(f"{path}: line {row.line} has {len(row.cells)} values for {width} columns{hint}")
    return names


def _used(cells: Sequence[str]) -> int:
    """Number of cells without the empty ones at the end."""
    return max((k for k, cell in enumerate(cells, start=1) if cell), default=0)


def _counts(row: _Row, after: _Row) -> bool:
    """True if the second line begins with the next whole number."""
    first, second = (re.fullmatch(r"(\d{1,9})(?:[.,]0*)?", one.cells[0]) for one in (row, after))
    return first is not None and second is not None and int(second[1]) == int(first[1]) + 1


def _named(path: Path, cells: Sequence[str], separator: str) -> dict[str, int]:
    names: dict[str, int] = {}
    for k, cell in enumerate(cells):
        word, *units = match.groups() if (match := _UNIT.fullmatch(cell[:_LONGEST])) else (cell,)
        bare, unit = re.sub(r"[\s_.-]", "", word.lower()), next((one for one in units if one), None)
        name = _KNOWN.get(bare)
        if name is None and bare not in _NOT_READ:
            raise ValueError(
                f"{path}: unknown column '{shown(cell, 40)}'{nearest(cell.lower(), _COLUMNS)} (the first line names "
                f"the columns; {_SEPARATORS[separator]} were taken to separate them)"
            )
        if name is None:
            continue
        if name in names:
            raise ValueError(
                f"{path}: the columns '{cells[names[name]]}' and '{cell}' are both {name}: keep one of them"
            )
        allowed = _UNITS[_COLUMNS[name].unit]
        if unit is not None and unit.lower() not in allowed:
            raise ValueError(f"{path}: column '{shown(cell, 40)}' is in {shown(unit, 20)}: must be in {allowed[0]}")
        names[name] = k
    return names


def _check_names(path: Path, names: Mapping[str, int]) -> None:
    """Refuse a table without both coordinates, or with two pairs of them."""
    on_earth = [name for name in ("lat", "lon") if name in names]
    if on_earth and ("x" in names or "y" in names):
        raise ValueError(f"{path}: has columns of x or y and of lat or lon: keep one pair")
    for name in ("lat", "lon") if on_earth else ("x", "y"):
        if name not in names:
            raise ValueError(f"{path}: column '{name}' is missing; a path needs x and y [m], or lat and lon [deg]")
    sides = [name for name in ("left_width", "right_width") if name in names]
    if len(sides) == 1:
        raise ValueError(f"{path}: has a column '{sides[0]}' only: give left_width and right_width, or neither")


def _decimal(path: Path, cells: Sequence[tuple[int, str]], separator: str) -> str:
    """The decimal sign of numbers, each with its line."""
    points = [(line, cell) for line, cell in cells if "." in cell]
    commas = [(line, cell) for line, cell in cells if "," in cell]
    for _, cell in commas:
        if "." in cell:
            return max(".,", key=cell.rfind)
    for sign, signed in ((",", points), (".", commas)):  # one that stands twice in a number is none
        if any(cell.count("." if sign == "," else ",") > 1 for _, cell in signed):
            return sign
    if not commas:
        return "."
    grouped = all(_GROUPED["."].fullmatch(cell) for _, cell in commas)
    if not points:
        return "." if grouped and separator == "," else ","
    if all(_GROUPED[","].fullmatch(cell) for _, cell in points) != grouped:
        return "." if grouped else ","
    (line, comma), (other, point) = commas[0], points[0]
    raise ValueError(
        f"{path}: line {line} has '{shown(comma, 20)}' and line {other} '{shown(point, 20)}': write all numbers with "
        "one decimal sign"
    )


def _written(cell: str, decimal: str, place: str) -> str:
    """A number as Python writes it."""
    if decimal == "." and _PLAIN.fullmatch(cell):
        return cell
    text, group = _GAP.sub("", cell).replace("\u2212", "-"), "," if decimal == "." else "."
    if group in text and not _GROUPED[decimal].fullmatch(text):
        raise ValueError(f"{place}: '{shown(cell, 40)}' is no number: '{decimal}' is the decimal sign of the others")
    return text.replace(group, "").replace(decimal, ".")
