"""Shared libraries from C source, kept in the user's cache, and kernels: functions of C files in a package.

``$OFFTRACK_COMPILER`` names the compiler, with words before or after its name as in ``CC`` ("ccache gcc"), or is
``none``; without it the first of cc, gcc and clang that works is used.
"""

import ctypes
import hashlib
import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from vehicle.foundation.temporary import temporary_folder
from vehicle.foundation.user_cache import FORMAT, cached, store, warn_once

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
_VERSIONS: Final = {  # macros of the version; clang has those of an old gcc as well
    "clang": ("clang_major", "clang_minor", "clang_patchlevel"),
    "gcc": ("GNUC", "GNUC_MINOR", "GNUC_PATCHLEVEL"),
}


class Compiler(NamedTuple):
    """A C compiler, and its flags for libraries on this machine."""

    path: str  # of its program, or of the one that calls it
    flags: tuple[str, ...]
    identity: str  # its macros: version, and the processor's features
    words: tuple[str, ...] = ()  # further ones of its command

    @property
    def command(self) -> tuple[str, ...]:
        """The command without flags."""
        return (self.path, *self.words)

    @property
    def name(self) -> str:
        """Name and version, such as "gcc 12.2.0"."""
        macros = dict(re.findall(r"^#define __(\w+?)__ (\d+)$", self.identity, re.MULTILINE))
        for name, parts in _VERSIONS.items():
            if parts[0] in macros:
                return f"{name} {'.'.join(macros[part] for part in parts)}"
        return self.path


class CompilerError(Exception):
    """A source could not be compiled or loaded."""


def compiler() -> Compiler | None:
    """The C compiler to use; None if there is none that works."""
    found = _compiler_or_reason()
    return found if isinstance(found, Compiler) else None


def engine_name() -> str:
    """Engine of the vehicle models in one line, for manifests and for the identity of runs.

    It is for example "compiled by gcc 12.2.0" or "interpreted (no C compiler found)".
    """
    found = _compiler_or_reason()
    return f"compiled by {found.name}" if isinstance(found, Compiler) else f"interpreted ({found})"


def warn_if_interpreted() -> None:
    """Warn in one line, once in a process, if vehicle models are interpreted."""
    if compiler() is None:
        warn_once(
            f"vehicle models are {engine_name()}: each of their steps takes about 5 times as long as a compiled one. "
            "Install gcc or clang, or name a C compiler in OFFTRACK_COMPILER."
        )


def _compiler_or_reason() -> Compiler | str:
    return _choice(os.environ.get("OFFTRACK_COMPILER", ""))


@cache
def _choice(wanted: str) -> Compiler | str:
    """The compiler to use, or the reason why there is none."""
    if wanted.lower() == "none":
        return "OFFTRACK_COMPILER is none"
    reason = f"OFFTRACK_COMPILER = {wanted} is no C compiler" if wanted else "no C compiler found"
    for name, *words in [_words(wanted)] if wanted else (["cc"], ["gcc"], ["clang"]):
        path = shutil.which(name)
        if path and (usable := _probed(path, words)):
            try:
                library("int works(void) { return 1; }", [], usable)
            except CompilerError as error:
                reason = str(error)
            else:
                return usable
    return reason


def _words(command: str) -> list[str]:
    """Words of a command; one that is the name of a program as a whole is not split."""
    try:
        return [command] if shutil.which(command) else shlex.split(command) or [command]
    except ValueError:  # an open quotation mark
        return [command]


def _probed(path: str, words: Sequence[str]) -> Compiler | None:
    for machine in _FOR_THIS_MACHINE:
        flags = (*_FLAGS, *machine)
        macros = _run([path, *words, *flags, "-dM", "-E", "-x", "c", os.devnull])
        if macros.returncode == 0:
            return Compiler(path, flags, macros.stdout, tuple(words))
    return None


def library(source: str, definitions: Iterable[str], using: Compiler) -> ctypes.CDLL:
    """Load the library of a source with macros defined (``NAME=VALUE``), from the cache or compiled.

    Raises:
        CompilerError: one line, if the compiler fails, or the library cannot be loaded.
    """
    flags = (*using.flags, *(f"-D{definition}" for definition in definitions))
    identity = "\0".join([FORMAT, *using.command, using.identity, *flags, source])
    key = hashlib.sha256(identity.encode()).hexdigest()[:32]
    try:
        content = cached(f"{key}.so")
        if content is None:
            content = _compiled(source, flags, using)
            store(f"{key}.so", content)
        return _loaded(content)
    except OSError as error:  # a full disk, or a system that runs nothing but installed programs
        raise CompilerError(f"{using.name} made no usable code: {error}") from error


def _compiled(source: str, flags: tuple[str, ...], using: Compiler) -> bytes:
    """Content of the library's file; compiled in a temporary folder that only this user can enter."""
    with temporary_folder() as folder:
        built = Path(folder, "built.so")
        result = _run([*using.command, *flags, "-x", "c", "-", "-o", str(built), "-lm"], source)
        if result.returncode != 0:
            raise CompilerError(f"{using.name} failed: {' '.join(result.stderr.split())[:500]}")
        return built.read_bytes()


def _loaded(content: bytes) -> ctypes.CDLL:
    """Load a library from these very bytes: from memory, or else from a temporary folder of this user alone."""
    try:
        return _loaded_from_memory(content)
    except (AttributeError, OSError):  # not Linux, or forbidden
        with temporary_folder() as folder:
            path = Path(folder, "built.so")
            path.write_bytes(content)
            return ctypes.CDLL(str(path))


def _loaded_from_memory(content: bytes) -> ctypes.CDLL:
    # The loader takes a name that it knows for the library that it knows. So the descriptor in the name stays open: a
    # process loads some ten libraries.
    descriptor = os.memfd_create("offtrack")
    with open(descriptor, "wb", closefd=False) as file:
        file.write(content)
    return ctypes.CDLL(f"/proc/self/fd/{descriptor}")


def _run(command: list[str], source: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, input=source, capture_output=True, text=True, check=False)


def kernel(package: str, file: str, name: str, definitions: tuple[str, ...] = ()) -> Callable[..., Any] | None:
    """Function of a C file with macros defined, of integers and contiguous arrays; None without a compiler."""
    return _kernel(package, file, name, definitions, compiler())


@cache
def _kernel(
    package: str, file: str, name: str, definitions: tuple[str, ...], using: Compiler | None
) -> Callable[..., Any] | None:
    source = (resources.files(package) / file).read_text(encoding="utf-8")
    try:
        function = using and library(source, definitions, using)[name]
    except CompilerError as error:
        warn_once(f"{file} is not compiled, slower code takes its place: {error}")
        return None
    return function and (lambda *arguments: function(*map(_passed, arguments)))


def _passed(argument: Any) -> Any:
    return ctypes.c_void_p(argument.ctypes.data) if isinstance(argument, np.ndarray) else ctypes.c_long(argument)
