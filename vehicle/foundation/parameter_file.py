"""Parameter files: TOML with sources, and libraries of them.

A number is written plain or as ``{ value = 8000.0, source = "weighed" }``; models see the plain number only.
"""

import difflib
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

from vehicle.foundation.user_file import MAX_NESTING, FileKind, FileType, read_text, shown

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
            raise ValueError(f"unknown {self.kind} '{name_or_path}'{hint} (known: {', '.join(known)}; or a .toml file)")
        return self._home() / f"{name_or_path}.toml"

    def usual(self) -> dict[str, Any]:
        """Contents of the reference file, sources removed."""
        contents: dict[str, Any] = without_sources(read_toml(self.file(self.reference)))
        return contents

    def _home(self) -> Path:
        return Path(str(resources.files("vehicle"))) / self.folder
