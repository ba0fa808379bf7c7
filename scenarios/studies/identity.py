"""Identity of a run: a hash of everything that its numbers depend on.

That is the resolved scenario with its seed, the content of every file that any of its values names, the user's own
modules with all that they import, offtrack's files, the versions of libraries, and the engine. Names of folders and
modification times do not count.

Files that a run opens without being named by its scenario, such as a table that an own law reads, are seen when they
are opened: see ``unnamed_files``.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from scenarios.results.files import digest
from scenarios.studies.own_modules import is_library, own_modules, package_folders
from vehicle.engine.compiler import compiler

_IMPORT_PATH: Final = re.compile(r"([A-Za-z_][\w.]*):[A-Za-z_]\w*")
_SYSTEM: Final = (
    *("/proc", "/sys", "/dev", "/run", "/etc", "/usr", "/lib", "/var", "/opt", "/Library", "/System"),
    *(sys.prefix, sys.base_prefix),
)
_DERIVED: Final = (".pyc", ".md")  # files of offtrack that no number depends on


def identity(scenario: Mapping[str, Any], seed: int) -> str:
    """Identity of a run of a resolved scenario."""
    content = json.dumps([_content(scenario), seed, software()], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:20]


def _content(node: Any) -> Any:
    """The scenario with the content of files and modules in the place of their names."""
    if isinstance(node, Mapping):
        return {key: _content(value) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_content(value) for value in node]
    files = _files_of(node) if isinstance(node, str) else {}
    name = str(node).rpartition(":")[2] if isinstance(node, str) and _IMPORT_PATH.fullmatch(node) else ""
    return [name, {key: digest(file) for key, file in files.items()}] if files else node


def _texts(node: Any) -> Iterator[str]:
    children = node.values() if isinstance(node, Mapping) else node if isinstance(node, list | tuple) else ()
    yield from (text for child in children for text in _texts(child))
    if isinstance(node, str):
        yield node


def _files_of(text: str) -> dict[str, Path]:
    """Files that a value stands for: own modules by their names, or a file of data as "data"."""
    match = _IMPORT_PATH.fullmatch(text)
    if match:
        return own_modules(match[1])
    try:
        return {"data": Path(text).resolve()} if Path(text).is_file() else {}
    except (OSError, ValueError, RuntimeError):  # too long, a null character, links in a circle: not a file's name
        return {}


def software() -> tuple[str, ...]:
    """Everything that computes: offtrack's files, versions of libraries, the engine with the machine's features."""
    return (*_installed(), str(compiler()))


@cache
def _installed() -> tuple[str, str]:
    sha = hashlib.sha256()
    for folder in package_folders():
        for file in sorted(folder.rglob("*")):
            if file.suffix not in _DERIVED and file.is_file():
                sha.update(f"{folder.name}/{file.relative_to(folder).as_posix()} {digest(file)}\n".encode())
    lines = [line for line in importlib.metadata.requires("offtrack") or () if ";" not in line]  # without extras
    needed = {name for line in lines for name in re.findall(r"^[\w.-]+", line)}
    libraries = {name: importlib.metadata.version(name) for name in sorted(needed)}
    return sha.hexdigest(), json.dumps([sys.version, libraries])


def unnamed_files(named: Sequence[Any], output: Path) -> dict[str, str]:
    """Digests of the user's files that this process has opened so far, without the named ones.

    The user's are all but those of libraries, of the system, and hidden ones. In the working directory and folders of
    named files, wherever these are, all but hidden ones count. Only files that Python's own functions opened are seen.

    Args:
        named: what names files of this run: its resolved scenario, and the file of that.
        output: file or folder that the study writes, which does not count.
    """
    _named.update(file for text in _texts(named) for file in _files_of(text).values())
    folders = {Path.cwd().resolve(), *(file.parent for file in _named)}
    seen = {_source(Path(os.path.realpath(path))) for path in tuple(_opened)} - _named
    output = output.resolve()
    users = (file for file in sorted(seen) if _is_users(file, folders) and not file.is_relative_to(output))
    return {str(file): digest(file) for file in users if file.is_file()}


def watch_files() -> None:
    """From now on remember the files that this process opens to read."""
    _watch_once()


_opened: set[str] = set()
_named: set[Path] = set()  # by any run of this process


@cache
def _watch_once() -> None:
    sys.addaudithook(_remember)  # cannot be removed


def _remember(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and not isinstance(arguments[0], int) and arguments[2] & os.O_ACCMODE == os.O_RDONLY:
        _opened.add(os.path.abspath(os.fsdecode(arguments[0])))


def _source(file: Path) -> Path:
    """The source of a compiled module; any other file as it is."""
    is_compiled = file.suffix == ".pyc" and file.parent.name == "__pycache__"
    return Path(importlib.util.source_from_cache(str(file))) if is_compiled else file


def _is_users(file: Path, folders: set[Path]) -> bool:
    inside = [file.relative_to(folder) for folder in folders if file.is_relative_to(folder)]
    if is_library(file) or (not inside and any(file.is_relative_to(folder) for folder in _SYSTEM)):
        return False
    return any(not any(part.startswith(".") for part in path.parts) for path in inside or [file])
