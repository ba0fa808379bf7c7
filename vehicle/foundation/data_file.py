"""Arrays, and tables of numbers as text, that a user gives, checked as they are read."""

import csv
import io
import math
import zipfile
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from vehicle.foundation.user_file import (
    MAX_FIELD,
    MAX_MEMBERS,
    MAX_NUMBERS,
    MAX_TABLE,
    FileKind,
    FileType,
    read_bytes,
    read_text,
    shown,
)
from vehicle.frames import FloatArray


def table_text(path: Path) -> str:
    """Text of a table that is not larger than ``MAX_TABLE`` numbers.

    Raises:
        ValueError: one line, if it is larger or cannot be read.
    """
    text = read_text(path, FileKind.TABLE)
    count = text.count(",") + max(text.count("\n"), text.count("\r"))
    if count > MAX_TABLE:
        raise ValueError(f"{path} has some {count} numbers: {FileKind.TABLE.noun} must have at most {MAX_TABLE}")
    return text


_MAX_HEADER: Final = 4096  # [bytes]
_HEADERS: Final[dict[tuple[int, int], Callable[..., Any]]] = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
}
_ENCRYPTED: Final = 0x1  # flag of a member
_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def read_array(path: Path) -> NDArray[Any]:
    """Array of numbers or words in a ``.npy`` file, read-only.

    Raises:
        ValueError: one line, if the file cannot be read or is not such an array.
    """
    return _array(read_bytes(path, FileKind.ARRAY), str(path))


def read_arrays(path: Path, kind: FileType) -> dict[str, NDArray[Any]]:
    """Arrays of a ``.npz`` file by name, read-only.

    Raises:
        ValueError: one line, if the file cannot be read or has members that are not such arrays.
    """
    members = read_archive(path, kind)
    return {name.removesuffix(".npy"): _array(content, f"{path}, {name}") for name, content in members.items()}


def read_archive(path: Path, kind: FileType) -> dict[str, bytes]:
    """Members of a zip file by name; all together must not exceed the limit of the kind.

    Raises:
        ValueError: one line, if the file cannot be read, is damaged or encrypted, or unpacks to more.
    """
    return unpacked(read_bytes(path, kind), str(path), kind)


def unpacked(content: bytes, name: str, kind: FileType) -> dict[str, bytes]:
    """Members of a zip file with this content; ``name`` stands for it in messages.

    Raises:
        ValueError: one line, as ``read_archive``.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            refusal = _refusal(members, kind)
            contents = {} if refusal else {member.filename: _member(archive, member) for member in members}
    except Exception as error:  # a damaged archive raises almost anything
        raise ValueError(f"{name} cannot be read as .npz or .zip: it is damaged or of another kind") from error
    if refusal:
        raise ValueError(f"{name} {refusal}")
    return contents


def _refusal(members: list[zipfile.ZipInfo], kind: FileType) -> str:
    """Reason why members must not be unpacked; empty if there is none."""
    total = sum(member.file_size for member in members)
    if len(members) > MAX_MEMBERS:
        return f"has {len(members)} members: {kind.noun} must have at most {MAX_MEMBERS}"
    if total > kind.limit:
        return f"unpacks to {total / 1e6:.4g} MB: {kind.noun} must have at most {kind.limit / 1e6:g} MB"
    if any(member.flag_bits & _ENCRYPTED or member.compress_type not in _METHODS for member in members):
        return f"is encrypted or packed by an unusual method: {kind.noun} must be stored or deflated"
    return ""


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    with archive.open(member) as file:
        return file.read(member.file_size)  # with a count, so that a member that states too little is not unpacked


def _array(content: bytes, name: str) -> NDArray[Any]:
    stream = io.BytesIO(content)
    try:
        shape, by_columns, kind = _HEADERS[npy.read_magic(stream)](stream, max_header_size=_MAX_HEADER)
    except Exception as error:  # the header is a Python expression
        raise ValueError(f"{name} cannot be read as .npy: its header is damaged or of another kind") from error
    if not (kind.kind in "biu" or kind.char in "efdU") or not kind.itemsize:
        raise ValueError(f"{name} has elements of type {shown(str(kind))}: they must be numbers or words")
    count, left = math.prod(shape), len(content) - stream.tell()
    if any(n < 0 for n in shape) or count > MAX_NUMBERS:
        raise ValueError(f"{name} has the shape {shown(str(shape))}: an array must have at most {MAX_NUMBERS} elements")
    if count * kind.itemsize > left:
        raise ValueError(f"{name} has {left} bytes for {count} elements of type {kind}: it is not complete")
    return np.frombuffer(content, kind, count, stream.tell()).reshape(shape, order="F" if by_columns else "C")


class Column(NamedTuple):
    """A column and the largest plausible size of its numbers."""

    name: str
    limit: float
    unit: str

    def number(self, text: str, place: str) -> float:
        """Number of a text at a place in a file.

        Raises:
            ValueError: if it is not a number within the limits.
        """
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(f"{place}: {self.name} = '{shown(text.strip(), 40)}' is not a finite number")
        if abs(value) > self.limit:
            raise ValueError(
                f"{place}: {self.name} = {value:g} must be within -{self.limit:g} to {self.limit:g} {self.unit}"
            )
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class NumberTable:
    """A table of which only the first line is interpreted yet."""

    path: Path
    names: list[str]  # of the columns
    lines: Iterator[list[str]]  # the others; empty ones are skipped

    def numbers(self, columns: Sequence[Column]) -> FloatArray:
        """Numbers (n, columns) of these columns; others are not interpreted.

        Raises:
            ValueError: one line naming file, line, column and limit, if a column is missing or a value is not a number
                within its limits.
        """
        wanted = [column.name for column in columns]
        for name in wanted:
            if name not in self.names:
                raise ValueError(f"{self.path}: column '{name}' is missing; expected {', '.join(wanted)}")
        places, values = [self.names.index(name) for name in wanted], array("d")
        for number, line in enumerate(self.lines, start=2):
            if len(line) != len(self.names):
                raise ValueError(f"{self.path}: line {number} has {len(line)} values for {len(self.names)} columns")
            for column, k in zip(columns, places, strict=True):
                values.append(column.number(line[k], f"{self.path}: line {number}"))
        return np.array(values, dtype=np.float64).reshape(-1, len(columns))


def open_table(path: Path) -> NumberTable:
    """Open a table of numbers.

    Raises:
        ValueError: one line, if the file cannot be read, has too many numbers, or names a column twice.
    """
    lines = _lines(path, table_text(path))
    names = [shown(name.strip()) for name in next(lines, [])]
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: two columns have the same name")
    return NumberTable(path=path, names=names, lines=lines)


def _lines(path: Path, text: str) -> Iterator[list[str]]:
    try:
        yield from (line for line in csv.reader(io.StringIO(text, newline="")) if line)
    except csv.Error:
        raise ValueError(f"{path}: a value has more than {MAX_FIELD} characters; is a quotation mark open?") from None
