"""Run directories: each appears complete or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def next_run_directory(scenario: str, root: Path = Path("runs")) -> Path:
    """The next ``runs/<scenario>-<n>``: n is 1, or one more than the largest in use."""
    taken = [path.name.removeprefix(f"{scenario}-") for path in root.glob(f"{scenario}-*")]
    return root / f"{scenario}-{1 + max((int(n) for n in taken if n.isdigit()), default=0)}"


def check_run_directory(directory: Path) -> None:
    """Refuse a directory that can not receive a complete run; call this before a long run.

    Raises:
        ValueError: if it is a file, is not empty, can not be replaced, or can not be made.
    """
    if directory.exists() and not directory.is_dir():
        raise ValueError(f"{directory} is a file: choose another name")
    if directory.is_dir() and any(directory.iterdir()):
        raise ValueError(f"directory {directory} is not empty: choose another, or remove it first")
    if directory.is_dir() and (directory.is_mount() or directory.resolve() == Path.cwd()):
        raise ValueError(f"directory {directory} can not be replaced as a whole: name a new folder inside it")
    parent = next(path for path in directory.resolve().parents if path.exists())
    if not (parent.is_dir() and os.access(parent, os.W_OK)):
        raise ValueError(f"directory {directory} can not be made: no permission to write in {parent}")


@contextmanager
def appearing_at_once(directory: Path) -> Iterator[Path]:
    """Yield a hidden folder next to ``directory``; on success it takes that name, otherwise it is removed."""
    check_run_directory(directory)
    directory = directory.resolve()
    directory.parent.mkdir(parents=True, exist_ok=True)
    unfinished = directory.with_name(f".{directory.name}.{os.getpid()}.unfinished")
    unfinished.mkdir()
    try:
        yield unfinished
        unfinished.rename(directory)  # replaces an empty directory, refuses one that has been filled meanwhile
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
