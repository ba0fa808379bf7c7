"""Identity of a run: a hash of everything its numbers depend on, including files that it opens unnamed.

That is the resolved scenario with its seed, the content of every file that any of its values names, the user's own
modules with all that they import, offtrack's files, the versions of libraries, and the engine. Names of folders and
modification times do not count.

Files that a run opens although its scenario does not name them, such as a table that an own law reads, are seen when
they are opened: see ``opened_files``.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import re
import sys
from collections.abc import Mapping, Set
from functools import cache
from pathlib import Path
from typing import Any, Final

from offtrack.hidden import package_folders
from scenarios.results.atomic_files import digest
from scenarios.results.run_inputs import is_file, is_import_path, named_modules, texts
from vehicle.engine.compiler import compiler
from vehicle.foundation.own_parts import is_library

_SYSTEM: Final = (
    *("/proc", "/sys", "/dev", "/run", "/etc", "/usr", "/lib", "/var", "/opt", "/Library", "/System"),
    *(sys.prefix, sys.base_prefix),
)
_Status = tuple[int, int, int] | None  # changes with the content of a file; None if there is none

_opened: dict[str, _Status] = {}  # in the present run, with the status at the first time
_written: set[str] = set()
_unnamed: dict[Path, _Status] = {}  # opened in any run that did not name them: their content may have been kept since


def watch_files() -> None:
    """Begin a run: from now on remember the files that this process opens by Python's own functions."""
    _watch_once()
    _opened.clear()


def opened_files(named: Set[Path]) -> dict[str, str]:
    """Digests of the user's files that runs of this process have opened without naming them.

    The user's are all but those of libraries, of the system, and hidden ones. In the working directory and folders of
    named files, wherever these are, all but hidden ones count. Files that the process writes itself do not count.

    Args:
        named: files that the present run names.

    Raises:
        ValueError: one line, if one of them has changed since it was opened.
    """
    folders = {Path.cwd().resolve(), *(file.parent for file in named)}
    written = {os.path.realpath(path) for path in _written}
    for path, status in tuple(_opened.items()):
        file = Path(os.path.realpath(path))
        if str(file) not in written and file not in named and _is_users(file, folders):
            _unnamed.setdefault(file, status)
    present = [file for file in sorted(_unnamed) if file.is_file()]  # others were temporary
    for file in present:
        if _status(str(file)) != _unnamed[file]:
            raise ValueError(f"{file} has changed while the study ran: repeat the command")
    return {str(file): digest(file) for file in present}


@cache
def _watch_once() -> None:
    sys.addaudithook(_remember)  # cannot be removed


def _remember(event: str, arguments: tuple[Any, ...]) -> None:
    """Note an opened file; called before it is opened, and for every event of the process: must not raise."""
    if event != "open" or not isinstance(arguments[0], str | bytes | os.PathLike):
        return
    path = os.path.abspath(os.fsdecode(arguments[0]))
    if arguments[2] & os.O_ACCMODE != os.O_RDONLY:
        _written.add(path)
        return
    folder, name = os.path.split(path)
    if name.endswith(".pyc") and os.path.basename(folder) == "__pycache__":  # its source counts
        path = os.path.join(os.path.dirname(folder), f"{name.partition('.')[0]}.py")
    if path not in _opened:
        _opened[path] = _status(path)


def _status(path: str) -> _Status:
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


def _is_users(file: Path, folders: Set[Path]) -> bool:
    inside = [file.relative_to(folder) for folder in folders if file.is_relative_to(folder)]
    if is_library(file) or (not inside and any(file.is_relative_to(folder) for folder in _SYSTEM)):
        return False
    visible = any(not any(part.startswith(".") for part in path.parts) for path in inside or [file])
    return visible and file.is_file()  # a missing one may be the name of a file in another folder


_DERIVED: Final = (".pyc", ".md")  # files of offtrack that no number depends on


def content(scenario: Mapping[str, Any], *, portable: bool = False) -> str:
    """Hash of a resolved scenario, of all files and modules that it names, and of the software.

    A ``portable`` one leaves the machine out: processor and compiler.
    """
    on = installed() if portable else software()
    return hashlib.sha256(json.dumps([_content(scenario), on], sort_keys=True).encode()).hexdigest()


def identity(content: str, seed: int) -> str:
    """Identity of a run of a scenario of this ``content``."""
    return hashlib.sha256(f"{content} {seed}".encode()).hexdigest()[:20]


def _content(node: Any) -> Any:
    """The scenario with the content of files and modules in the place of their names."""
    if isinstance(node, Mapping):
        return {key: _content(value) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_content(value) for value in node]
    files = _files_of(node) if isinstance(node, str) else {}
    name = str(node).rpartition(":")[2] if isinstance(node, str) and is_import_path(node) else ""
    return [name, {key: digest(file) for key, file in files.items()}] if files else node


def named_files(node: Any) -> set[Path]:
    """All files that values of a scenario name, and those of its own modules."""
    return {file for text in texts(node) for file in _files_of(text).values()}


def _files_of(text: str) -> dict[str, Path]:
    """Files that a value stands for: own modules by their names, or a file of data as "data"."""
    if is_import_path(text):
        return named_modules(text)
    return {"data": Path(text).resolve()} if is_file(text) else {}


def software() -> tuple[str, ...]:
    """Everything that computes: offtrack's files, versions of libraries, the engine with the machine's features."""
    return (*installed(), str(compiler()))


@cache
def installed() -> tuple[str, str]:
    """Hash of offtrack's files, and versions of Python and the libraries as JSON."""
    sha = hashlib.sha256()
    for folder in package_folders():
        for file in sorted(folder.rglob("*")):
            if file.suffix not in _DERIVED and file.is_file():
                sha.update(f"{folder.name}/{file.relative_to(folder).as_posix()} {digest(file)}\n".encode())
    lines = [line for line in importlib.metadata.requires("offtrack") or () if ";" not in line]  # without extras
    needed = {name for line in lines for name in re.findall(r"^[\w.-]+", line)}
    libraries = {name: importlib.metadata.version(name) for name in sorted(needed)}
    return sha.hexdigest(), json.dumps([sys.version, libraries])
