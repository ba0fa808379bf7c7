"""Files that a user names: their reader, which refuses all but regular files of limited size; parameter files (TOML).

``FileKind`` and the numbers below it are the limits on such files; a room with a kind of file of its own declares a
``FileType`` of it.

A number is written plain or as ``{ value = 8000.0, source = "weighed" }``; models see the plain number only.
"""

import difflib
import errno
import json
import os
import re
import stat
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib import resources
from pathlib import Path
from typing import Any, Final

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
_REASONS: Final = {errno.ELOOP: "its symbolic links form a circle", errno.ENAMETOOLONG: "its name is too long"}


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
            status = os.fstat(descriptor)
            _check(path, status, kind)  # the name may stand for another file by now
            content = file.read(status.st_size + 1) or b""  # None: a file of the system that has nothing yet
            if len(content) > status.st_size:  # it grows, or it is a file of the system that states no size
                content += file.read(kind.limit + 1 - len(content)) or b""
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {reason(error)}") from None
    if len(content) > kind.limit:
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


def read_json(path: Path, kind: FileType, *, constants: bool = False) -> dict[str, Any]:
    """Object in a JSON file.

    Raises:
        ValueError: one line, as ``read_text``, or if it holds no object, is nested too deeply, or has a NaN or an
            infinity, unless ``constants`` are allowed.
    """
    text = read_text(path, kind)
    try:
        found = json.loads(text, parse_constant=None if constants else _no_constant)
    except RecursionError:
        raise ValueError(f"{path}: not JSON: {_TOO_DEEP}") from None
    except ValueError as error:
        raise ValueError(f"{path}: not JSON: {shown(str(error))}") from None
    if not isinstance(found, dict):
        raise ValueError(f"{path}: must hold a JSON object {{…}}")
    return found


def _no_constant(name: str) -> None:
    raise ValueError(f"it has no {name}")


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


_LISTED: Final = 20  # words in an error message
_COMPARED: Final = 100  # characters of a word
_PART: Final = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY: Final = re.compile(  # takes tomllib quadratic time
    rf"(?:^|[{{,])[ \t]*+\[{{0,2}}[ \t]*+(?:{_PART}\.[ \t]*+){{{MAX_NESTING}}}", re.MULTILINE
)

_TOO_DEEP: Final = f"tables and lists must be nested at most {MAX_NESTING} deep"
_TOO_BIG: Final = "an integer must fit into 64 bits"


def read_toml(path: Path, kind: FileType = FileKind.PARAMETERS) -> dict[str, Any]:
    """Contents of a TOML file, sources included.

    Raises:
        ValueError: one line, if the file cannot be read or is not TOML.
    """
    try:
        return parsed_toml(read_text(path, kind))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: not a TOML file: {shown(str(error), 200)}") from error


def parsed_toml(text: str) -> dict[str, Any]:
    """Tables of a TOML text.

    Raises:
        TOMLDecodeError: one line, if it is not TOML, is nested deeper than ``MAX_NESTING``, or has an integer that does
            not fit into 64 bits.
    """
    if _LONG_KEY.search(text):
        raise tomllib.TOMLDecodeError(f"a key has more than {MAX_NESTING} parts")
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except (RecursionError, ValueError) as error:  # ValueError: an integer of thousands of digits
        raise tomllib.TOMLDecodeError(_TOO_DEEP if isinstance(error, RecursionError) else _TOO_BIG) from None
    _check_tree(table)
    return table


def _check_tree(table: dict[str, Any]) -> None:
    level: list[Any] = [table]
    for _ in range(MAX_NESTING + 1):  # no recursion, which has its own limit
        if any(isinstance(node, int) and not -(2**63) <= node < 2**63 for node in level):
            raise tomllib.TOMLDecodeError(_TOO_BIG)
        level = [child for node in level for child in _children(node)]
    if level:
        raise tomllib.TOMLDecodeError(_TOO_DEEP)


def _children(node: Any) -> Iterable[Any]:
    return node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()


def without_sources(node: Any) -> Any:
    """Copy of the tree with every ``{value, source}`` replaced by its value."""
    if isinstance(node, dict):
        if node.keys() == {"value", "source"}:
            return node["value"]
        return {key: without_sources(child) for key, child in node.items()}
    if isinstance(node, list):
        return [without_sources(child) for child in node]
    return node


def sources(node: Any, key: str = "") -> dict[str, str]:
    """Sources of the numbers that state one, by dotted key."""
    if isinstance(node, dict) and node.keys() == {"value", "source"}:
        return {key: str(node["source"])}
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    by_key: dict[str, str] = {}
    for name, child in children:
        by_key |= sources(child, f"{key}.{name}" if key else str(name))
    return by_key


def dotted(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Values of a table, and of the tables in it, with their dotted keys."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value


def nearest(word: str, known: Iterable[str]) -> str:
    """Ending of an error message on an unknown word: the known word most like it, or else known words, not too many."""
    words, word = list(known), word[:_COMPARED]
    if not words:
        return "; there are none"
    close = difflib.get_close_matches(word, words, n=1, cutoff=0.5)
    if close:
        return f"; did you mean '{close[0]}'?"
    if len(words) > _LISTED:
        return f"; most like it: {', '.join(difflib.get_close_matches(word, words, n=3, cutoff=0.0))}"
    return f"; known: {', '.join(words)}"


@dataclass(frozen=True, slots=True)
class ParameterLibrary:
    """All parameter files of one kind."""

    kind: str  # noun for messages: "vehicle"
    folder: str  # in this package
    reference: str = ""  # name of the file whose values are usual ones

    def names(self) -> tuple[str, ...]:
        """Names of the files, without suffix."""
        return tuple(sorted(path.stem for path in self._home().glob("*.toml")))

    def file(self, name_or_path: str) -> Path:
        """Path of the file of this name; a path that ends in ``.toml`` is returned as it is.

        Raises:
            ValueError: one line with the nearest known name.
        """
        if name_or_path.endswith(".toml"):
            return Path(name_or_path)
        known = self.names()
        if name_or_path not in known:
            hint = nearest(name_or_path, known)
            listed = "" if hint.startswith("; known") else f" (known: {', '.join(known)})"
            raise ValueError(f"unknown {self.kind} '{name_or_path}'{hint}{listed}; or name a .toml file")
        return self._home() / f"{name_or_path}.toml"

    def usual(self) -> dict[str, Any]:
        """Contents of the reference file, sources removed."""
        contents: dict[str, Any] = without_sources(read_toml(self.file(self.reference)))
        return contents

    def _home(self) -> Path:
        return Path(str(resources.files("vehicle"))) / self.folder
