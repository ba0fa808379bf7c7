"""Names of files among the values of a scenario."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

MAP_SUFFIX: Final = ".toml"  # after the name of an FMU: its map


def with_neighbours(scenario: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Scenario in which relative names of files in ``folder``, where it comes from, are absolute paths.

    A name without a suffix is that of a part or of shipped data, never of a file.
    """

    def found(text: str) -> str:
        relative = bool(Path(text).suffix) and not os.path.isabs(text)
        return str((folder / text).absolute()) if relative and is_file(folder / text) else text

    changed: dict[str, Any] = with_texts(scenario, found)
    return changed


def texts(node: Any) -> Iterator[str]:
    """All texts among the values of a scenario."""
    children = node.values() if isinstance(node, Mapping) else node if isinstance(node, list | tuple) else ()
    yield from (text for child in children for text in texts(child))
    if isinstance(node, str):
        yield node


def with_texts(node: Any, change: Callable[[str], str]) -> Any:
    """A scenario's tables and lists with all texts among their values changed."""
    if isinstance(node, Mapping):
        return {key: with_texts(value, change) for key, value in node.items()}
    if isinstance(node, list):
        return [with_texts(value, change) for value in node]
    return change(node) if isinstance(node, str) else node


def is_file(path: str | Path) -> bool:
    """True if a text is the name of a regular file."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError, RuntimeError):  # too long, a null character, links in a circle: not a file's name
        return False
