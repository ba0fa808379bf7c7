"""Files that appear complete or not at all, and folders that one process uses at a time."""

import fcntl
import hashlib
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Final

_UNFINISHED: Final = re.compile(r"\..+\.\d+\.unfinished")


def check_new_file(path: Path) -> None:
    """Refuse a name under which no new file can be written; call this before long work.

    Raises:
        ValueError: one line.
    """
    if path.exists():
        raise ValueError(f"{path} exists already: choose another file with --out")
    if not (path.parent.is_dir() and os.access(path.parent, os.W_OK)):
        raise ValueError(f"{path}: there is no folder {path.parent} to write in; make it, or choose another file")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the name of an unfinished file, which on success takes the place of ``path`` and otherwise is removed."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        yield unfinished
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def replaced(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def unfinished_files(folder: Path) -> list[Path]:
    """Unfinished files in a folder; if only this process uses it, killed processes have left them."""
    return [path for path in folder.iterdir() if _UNFINISHED.fullmatch(path.name) and path.is_file()]


@contextmanager
def user_of(folder: Path) -> Iterator[None]:
    """Lock a folder; the lock ends with this process at the latest.

    Raises:
        ValueError: one line, if another process has locked it.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        if not locked(descriptor):
            raise ValueError(f"directory {folder}: another process works in it; wait, or choose another")
        yield
    finally:
        os.close(descriptor)


def locked(descriptor: int) -> bool:
    """Lock an open file or folder until it is closed; False if another process has locked it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def digest(file: Path) -> str:
    """SHA-256 of a file's content; empty if it is no regular file or cannot be read."""
    try:
        status = file.stat()
        is_regular = stat.S_ISREG(status.st_mode)  # a device or a pipe may never end
        return _digest(file, status.st_mtime_ns, status.st_size, status.st_ino) if is_regular else ""
    except OSError:
        return ""


@lru_cache(maxsize=10_000)
def _digest(file: Path, *_: int) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
