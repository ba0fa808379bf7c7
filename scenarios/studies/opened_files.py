"""Files that runs open although their scenarios do not name them, such as a table that an own law reads."""

from __future__ import annotations

import os
import sys
from collections.abc import Set
from functools import cache
from pathlib import Path
from typing import Any, Final

from scenarios.results.files import digest
from vehicle.own_code import is_library

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
