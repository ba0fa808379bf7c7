"""Shared libraries from C source, cached by the hash of source, flags and compiler.

``$OFFTRACK_COMPILER`` names the compiler, or is ``none``; without it the first of cc, gcc and clang is used. Libraries
are cached in ``$OFFTRACK_CACHE``, else in ``offtrack`` under the user's cache directory.
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

# Relaxations of IEEE arithmetic that change no relevant result. Not -ffast-math: in a shared library, it makes the
# processor flush denormal numbers to zero in the whole process.
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
    """A C compiler, and its flags for libraries on this machine."""

    path: str
    flags: tuple[str, ...]
    identity: str  # its macros: version, and the processor's features


class CompilerError(Exception):
    """A source could not be compiled or loaded."""


def compiler() -> Compiler | None:
    """The C compiler to use; None if there is none."""
    wanted = os.environ.get("OFFTRACK_COMPILER", "")
    if wanted.lower() == "none":
        return None
    paths = (shutil.which(name) for name in ([wanted] if wanted else ["cc", "gcc", "clang"]))
    return next((usable for path in paths if path and (usable := _probed(path))), None)


@cache
def _probed(path: str) -> Compiler | None:
    for machine in _FOR_THIS_MACHINE:
        flags = (*_FLAGS, *machine)
        macros = _run([path, *flags, "-dM", "-E", "-x", "c", os.devnull])
        if macros.returncode == 0:
            return Compiler(path, flags, macros.stdout)
    return None


def library(source: str, definitions: Iterable[str], using: Compiler) -> ctypes.CDLL:
    """Compile the source with macros defined (``NAME=VALUE``), and load the library.

    Raises:
        CompilerError: if the compiler fails, or the library cannot be stored or loaded.
    """
    flags = (*using.flags, *(f"-D{definition}" for definition in definitions))
    identity = "\0".join([using.path, using.identity, *flags, source])
    key = hashlib.sha256(identity.encode()).hexdigest()[:32]
    directory = _directory()
    try:
        return ctypes.CDLL(str(_cached(directory, key) or _make(source, flags, using, directory, key)))
    except OSError as error:  # a full disk, or a directory from which nothing may be executed
        raise CompilerError(f"no library in {directory}: {error}") from error


def _cached(directory: Path, key: str) -> Path | None:
    """Cached library of this key; None if there is none, or its content does not have the hash in its name."""
    return next((path for path in directory.glob(f"{key}-*.so") if path.stem == f"{key}-{_digest(path)}"), None)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:32]


def _make(source: str, flags: tuple[str, ...], using: Compiler, directory: Path, key: str) -> Path:
    """Compile to a temporary file and rename it, so that another process sees a whole library or none."""
    with tempfile.TemporaryDirectory(dir=directory, prefix="build-") as folder:
        text, built = Path(folder, "source.c"), Path(folder, "built.so")
        text.write_text(source, encoding="utf-8")
        result = _run([using.path, *flags, str(text), "-o", str(built), "-lm"])
        if result.returncode != 0:
            raise CompilerError(f"{using.path} failed: {result.stderr.strip()[:2000]}")
        cached = directory / f"{key}-{_digest(built)}.so"
        built.replace(cached)
    _LOG.info("compiled %s", cached)
    return cached


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _directory() -> Path:
    """Directory of the cache; a temporary one of this process if that cannot be written."""
    try:
        chosen = Path(os.environ.get("OFFTRACK_CACHE") or _user_cache() / "offtrack")
        chosen.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        _LOG.info("%s: compiled code is not cached", error)
        return Path(_own_directory().name)
    return chosen if os.access(chosen, os.W_OK) else Path(_own_directory().name)


def _user_cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


@cache
def _own_directory() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="offtrack-")
