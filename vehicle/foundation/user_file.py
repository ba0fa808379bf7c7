"""Reader of all files that a user names: regular files of limited size; anything else is refused in one line.

``FileKind`` and the numbers below it are the limits on such files; a room with a kind of file of its own declares a
``FileType`` of it.
"""

import errno
import os
import stat
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final

_MB: Final = 1_000_000


@dataclass(frozen=True)
class FileType:
    """A type of file that a user can give."""

    noun: str  # in messages, with its article
    limit: int  # largest size [bytes]


class FileKind(FileType, Enum):
    """The types of file that more than one room reads."""

    PARAMETERS = "a parameter file", 1 * _MB
    SCENARIO = "a scenario file", 1 * _MB
    CALIBRATION = "a calibration file", 1 * _MB
    TABLE = "a table of numbers", 64 * _MB
    IMAGE = "an image", 256 * _MB
    ARRAY = "an array of numbers", 256 * _MB
    SIGNALS = "a file of signals", 512 * _MB
    CHECKPOINT = "a checkpoint of a training", 64 * _MB
    RECORD = "a record of an earlier command", 64 * _MB
    ROAD = "a file of a road or path", 32 * _MB
    SURFACE = "a measured surface", 512 * _MB
    FMU = "an FMU", 512 * _MB


MAX_PIXELS: Final = 64 * _MB  # of an image
MAX_NUMBERS: Final = 16 * _MB  # of an array
MAX_TABLE: Final = 4 * _MB  # numbers of a table as text
MAX_FRAMES: Final = 100_000  # of a recording
MAX_FIELD: Final = 131_072  # characters between two commas of a table: the limit of the csv module
MAX_NESTING: Final = 32  # of tables and lists in each other, and of the parts of a dotted key
MAX_MEMBERS: Final = 1_000  # of an archive
MAX_ELEMENTS: Final = 2 * _MB  # of an XML file
MAX_POINTS: Final = 200_000  # of a path

_UNUSUAL: Final = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_REASONS: Final = {
    errno.ELOOP: "its symbolic links form a circle",
    errno.ENAMETOOLONG: "its name is too long",
}


def read_bytes(path: Path, kind: FileType) -> bytes:
    """Content of a regular file; never waits for a pipe and opens no device.

    Raises:
        ValueError: one line, if there is no such file, it is not a regular one, or it is larger than the kind's limit.
    """
    full_path(path)
    try:
        _check(path, os.stat(path), kind)
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        with open(descriptor, "rb") as file:
            _check(path, os.fstat(descriptor), kind)  # the name may stand for another file by now
            content = file.read(kind.limit + 1) or b""  # None: a file of the system that has nothing yet
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {reason(error)}") from None
    if len(content) > kind.limit:  # it grows, or it is a file of the system that states no size
        raise _too_large(path, f"more than {_size(kind.limit)}", kind)
    return content


def read_text(path: Path, kind: FileType) -> str:
    """Content of a text file in UTF-8, with or without a byte order mark; line ends are not translated.

    Raises:
        ValueError: one line, as ``read_bytes``, or if it is not UTF-8.
    """
    try:
        return read_bytes(path, kind).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        raise ValueError(f"{path}: not a text in UTF-8: byte 0x{byte:02x} at {error.start}; save it as UTF-8") from None


def full_path(path: str | Path) -> str:
    """Absolute path without symbolic links, except of its last name, whose suffix may tell the kind of file.

    Raises:
        ValueError: if it contains a null character.
    """
    if "\0" in str(path):
        raise ValueError(f"{str(path)!r}: a path must not contain a null character")
    folder, name = os.path.split(path)
    if name in (".", ".."):
        folder, name = os.fspath(path), ""
    return str(Path(os.path.realpath(folder), name))  # Path.resolve raises RuntimeError for links in a circle


def reason(error: OSError) -> str:
    """The system's reason in plain words."""
    return _REASONS.get(error.errno or 0) or error.strerror or type(error).__name__


def shown(text: str, length: int = 120) -> str:
    """Text from a file for an error message: in one line, cut after a number of characters."""
    printable = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text[: length + 1])
    return printable if len(printable) <= length else f"{printable[:length]}..."


def _check(path: Path, status: os.stat_result, kind: FileType) -> None:
    for is_kind, noun in _UNUSUAL:
        if is_kind(status.st_mode):
            raise ValueError(f"{path} is {noun}: {kind.noun} must be a regular file")
    if status.st_size > kind.limit:
        raise _too_large(path, _size(status.st_size), kind)


def _too_large(path: Path, amount: str, kind: FileType) -> ValueError:
    return ValueError(f"{path} has {amount}: {kind.noun} must have at most {_size(kind.limit)}")


def _size(count: int) -> str:
    return f"{count / _MB:.4g} MB"
