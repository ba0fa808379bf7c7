"""A user's own parts: where their code is, for messages, and how they are closed."""

import inspect
import logging
import os
import site
import sysconfig
import traceback
from functools import cache
from pathlib import Path
from typing import Protocol, runtime_checkable


def raised_at(error: BaseException) -> str:
    """Place of the user's own code where an exception arose, such as `` (my_law.py, line 12)``, or nothing."""
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        if place := _place(frame.f_code.co_filename, line):
            return place
    return ""


def defined_at(method: object) -> str:
    """Place where a function or class of the user's own is defined, as `raised_at`; empty for any other."""
    try:
        file = inspect.getsourcefile(method)  # type: ignore[arg-type]
        line = inspect.getsourcelines(method)[1]  # type: ignore[arg-type]
    except (TypeError, OSError):  # no function or class, or without its source
        return ""
    return _place(file or "", line)


def _place(file: str, line: int) -> str:
    path = Path(file)
    if path.suffix != ".py" or is_library(path.resolve()):
        return ""
    shown = os.path.relpath(path) if path.is_absolute() and path.is_relative_to(Path.cwd()) else str(path)
    return f" ({shown}, line {line})"


def is_library(file: Path) -> bool:
    """True if a file belongs to offtrack, Python or an installed library."""
    return any(file.is_relative_to(folder) for folder in _library_folders())


@cache
def _library_folders() -> tuple[Path, ...]:
    """Folders of offtrack's packages, which lie beside this one and are typed, and of everything installed."""
    beside = Path(__file__).resolve().parents[2]
    python = (sysconfig.get_path(key) for key in ("stdlib", "platstdlib", "purelib", "platlib"))
    installed = {*python, *site.getsitepackages(), site.getusersitepackages()}
    return (*(marker.parent for marker in beside.glob("*/py.typed")), *(Path(path).resolve() for path in installed))


_LOG = logging.getLogger(__name__)


@runtime_checkable
class Closes(Protocol):
    """A part that holds a process, a file or a connection. A part that wraps others closes them."""

    def close(self) -> None:
        """Free it; nothing is asked of the part afterwards. A second call does nothing."""


def close_part(part: object) -> None:
    """Close a part if it is one of those that must be; an error of a user's own part is a warning, the run is done."""
    if not isinstance(part, Closes):
        return
    try:
        part.close()
    except Exception as error:  # of a user's class: of any kind
        _LOG.warning("offtrack: %s.close() raised %s: %s", type(part).__name__, type(error).__name__, error)
