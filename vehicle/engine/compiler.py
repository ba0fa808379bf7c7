"""Shared libraries from C source, made once: kept by the hash of all that they were made from.

``$OFFTRACK_COMPILER`` names the compiler, or is ``none``; without it the first of cc, gcc and clang is taken. Libraries
are kept in ``$OFFTRACK_CACHE``, else in ``offtrack`` under the user's cache directory.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

_LOG = logging.getLogger(__name__)

# What IEEE arithmetic is spared of changes no number that matters. Not -ffast-math: linked into a shared library, it
# makes the processor flush denormal numbers to zero in the whole process.
_FLAGS: Final = (
    *("-std=gnu11", "-O3", "-fPIC", "-shared", "-w"),
    *("-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-ffinite-math-only"),
)
_FOR_THIS_MACHINE: Final[tuple[tuple[str, ...], ...]] = (
    ("-march=native", "-mprefer-vector-width=512"),  # the first of these that the compiler takes
    ("-march=native",),
    ("-mcpu=native",),
    (),
)


class Compiler(NamedTuple):
    """A C compiler, and the flags with which it makes libraries for this machine."""

    path: str
    flags: tuple[str, ...]
    identity: str  # its macros: version, and what the processor can do


class CompilerError(Exception):
    """No library came of a source."""


def compiler() -> Compiler | None:
    """The C compiler to use, if there is one."""
    wanted = os.environ.get("OFFTRACK_COMPILER", "")
    if wanted.lower() == "none":
        return None
    paths = (shutil.which(name) for name in ([wanted] if wanted else ["cc", "gcc", "clang"]))
    return next((found for path in paths if path and (found := _probed(path))), None)


@cache
def _probed(path: str) -> Compiler | None:
    for machine in _FOR_THIS_MACHINE:
        flags = (*_FLAGS, *machine)
        macros = _run([path, *flags, "-dM", "-E", "-x", "c", os.devnull])
        if macros.returncode == 0:
            return Compiler(path, flags, macros.stdout)
    return None


def library(source: str, definitions: Iterable[str], using: Compiler) -> ctypes.CDLL:
    """The source compiled with some macros defined (``NAME=VALUE``) and loaded.

    Raises:
        CompilerError: if the compiler refuses it, or what it made can not be kept or loaded.
    """
    flags = (*using.flags, *(f"-D{definition}" for definition in definitions))
    made_from = "\0".join([using.path, using.identity, *flags, source])
    key = hashlib.sha256(made_from.encode()).hexdigest()[:32]
    directory = _directory()
    try:
        return ctypes.CDLL(str(_kept(directory, key) or _make(source, flags, using, directory, key)))
    except OSError as error:  # a full disk, or a directory from which nothing may be executed
        raise CompilerError(f"no library in {directory}: {error}") from error


def _kept(directory: Path, key: str) -> Path | None:
    """The library of this key whose content is what its name says: neither cut short nor written over."""
    return next((path for path in directory.glob(f"{key}-*.so") if path.stem == f"{key}-{_digest(path)}"), None)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:32]


def _make(source: str, flags: tuple[str, ...], using: Compiler, directory: Path, key: str) -> Path:
    """Compiles under a name of its own, then renames: another process sees a whole library or none."""
    with tempfile.TemporaryDirectory(dir=directory, prefix="making-") as workshop:
        text, made = Path(workshop, "source.c"), Path(workshop, "made.so")
        text.write_text(source, encoding="utf-8")
        done = _run([using.path, *flags, str(text), "-o", str(made), "-lm"])
        if done.returncode != 0:
            raise CompilerError(f"{using.path} failed: {done.stderr.strip()[:2000]}")
        kept = directory / f"{key}-{_digest(made)}.so"
        made.replace(kept)
    _LOG.info("compiled %s", kept)
    return kept


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _directory() -> Path:
    """Where libraries are kept; where nothing can be written, a place of this process alone."""
    try:
        chosen = Path(os.environ.get("OFFTRACK_CACHE") or _user_cache() / "offtrack")
        chosen.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        _LOG.info("%s: compiled code is not kept", error)
        return Path(_own_directory().name)
    return chosen if os.access(chosen, os.W_OK) else Path(_own_directory().name)


def _user_cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


@cache
def _own_directory() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="offtrack-")
