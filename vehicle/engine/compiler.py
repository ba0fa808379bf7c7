"""Shared libraries from C source, in a cache that gives out nothing which another user could have written.

``$OFFTRACK_COMPILER`` names the compiler, or is ``none``; without it the first of cc, gcc and clang that works is used.

The cache is ``$OFFTRACK_CACHE``, else ``offtrack`` in the user's cache directory. The folder and its files must belong
to this user and be writable by nobody else, and nobody else may be able to rename a folder above it. A file holds its
content and a hash of key and content, which tells damage. A file is opened once, and the bytes that are checked are the
bytes that are returned.

A folder or file that is not trusted is named in one warning, and its content is made again. A folder that is full or
read-only has the same effect without a warning. What remains: root, and programs of this same user, are trusted.
"""

import ctypes
import hashlib
import logging
import os
import re
import secrets
import shutil
import stat
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

_LOG = logging.getLogger(__name__)

_FORMAT: Final = "sha256 at the end"  # of the cache's files
_N_HASH: Final = hashlib.sha256().digest_size  # [bytes], at the end of every file
_BUILD: Final = "build-"  # begins the names of files that are being written
_ABANDONED: Final = 3600.0  # age at which the writer of such a file is gone; writing takes a moment [s]
_ADVICE: Final = "Set OFFTRACK_CACHE to a folder that only you can write"

ResultT = TypeVar("ResultT")


class _RefusedError(OSError):
    """A folder or file that is not trusted."""


def cached(name: str) -> bytes | None:
    """Content stored under the name, a key and an ending; None if there is none that can be trusted."""
    return _in_folder(lambda folder: _found(folder, name))


def store(name: str, content: bytes) -> None:
    """Store content under the name, whole or not at all; replaces what is not trusted."""
    _in_folder(lambda folder: _stored(folder, name, content))


def _in_folder(action: Callable[[int], ResultT]) -> ResultT | None:
    """Result of the action with the folder's descriptor; None if that fails or is not trusted."""
    try:
        folder = _opened(_path())
        try:
            return action(folder)
        finally:
            os.close(folder)
    except _RefusedError as error:
        warn_once(f"cached code is not used, and the vehicle model is made again: {error}.")
    except OSError as error:
        _LOG.info("vehicle models are not cached: %s", error)
    return None


def _path() -> Path:
    user_cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("OFFTRACK_CACHE") or Path(user_cache, "offtrack")).resolve()


def _opened(path: Path) -> int:
    """Descriptor of the folder, which is made if it is missing.

    Raises:
        OSError: if it can not be made, or somebody else could write to it or exchange it.
    """
    chain = [*reversed(path.parents), path]
    for folder in chain:
        if not folder.exists():
            folder.mkdir(mode=0o700, exist_ok=True)  # another process may be faster
    for parent in chain[:-1]:
        _check(parent, os.lstat(parent), above=True)
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        _check(path, os.fstat(descriptor))
    except _RefusedError:
        os.close(descriptor)
        raise
    return descriptor


def _check(path: Path, status: os.stat_result, *, above: bool = False) -> None:
    """Refuse what belongs to another user or what others can write to.

    A folder ``above`` the cache may belong to root, and others may write to it if its sticky bit keeps them from
    renaming what is not theirs.
    """
    me = os.geteuid()
    if status.st_uid != me and not (above and status.st_uid == 0):
        raise _RefusedError(f"{path} belongs to user {status.st_uid}, not to you (user {me}). {_ADVICE}")
    if status.st_mode & 0o022 and not (above and status.st_mode & stat.S_ISVTX):
        mode = f"{stat.S_IMODE(status.st_mode):o}"
        raise _RefusedError(f"{path} is open to other users (mode {mode}). {_ADVICE}, or run: chmod go-w '{path}'")


def _found(folder: int, name: str) -> bytes | None:
    try:
        whole = _read(folder, name)
    except FileNotFoundError:
        return None
    content, stored = whole[:-_N_HASH], whole[-_N_HASH:]
    if stored != _hash(name, content):
        raise _RefusedError(f"{_path() / name} is damaged")
    return content


def _stored(folder: int, name: str, content: bytes) -> None:
    """Write a file under a temporary name, which then becomes its name."""
    _clear(folder)
    temporary = f"{_BUILD}{secrets.token_hex(8)}"
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600, dir_fd=folder)
    try:
        with open(descriptor, "wb") as file:
            file.write(content + _hash(name, content))
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    finally:
        with suppress(FileNotFoundError):  # it was renamed
            os.unlink(temporary, dir_fd=folder)


def _hash(name: str, content: bytes) -> bytes:
    """Hash of content under the key in its name."""
    return hashlib.sha256(name.partition(".")[0].encode() + content).digest()


def _read(folder: int, name: str) -> bytes:
    """Content of a file.

    Raises:
        FileNotFoundError: if there is none.
        _RefusedError: if it can not be read, is no regular file, belongs to another user, or others can write to it.
    """
    path = _path() / name
    try:
        descriptor = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise _RefusedError(f"{path}: {error.strerror}. Remove it") from error
    with open(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise _RefusedError(f"{path} is no regular file. Remove it")
        _check(path, status)
        return file.read()


def _clear(folder: int) -> None:
    """Remove what killed processes left half-written."""
    for name in os.listdir(folder):
        if name.startswith(_BUILD):
            with suppress(OSError):  # another process removed it
                if time.time() - os.stat(name, dir_fd=folder, follow_symlinks=False).st_mtime > _ABANDONED:
                    shutil.rmtree(_path() / name) if (_path() / name).is_dir() else os.unlink(name, dir_fd=folder)


@cache
def warn_once(message: str) -> None:
    """Log a warning, once in a process and not in worker processes, see :func:`silence`."""
    _LOG.warning("offtrack: %s", message)


def silence() -> None:
    """Log no warnings from here on: for worker processes, whose parent has logged the same ones."""
    _LOG.setLevel(logging.ERROR)


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

    path: str
    flags: tuple[str, ...]
    identity: str  # its macros: version, and the processor's features

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
    for path in (shutil.which(name) for name in ([wanted] if wanted else ["cc", "gcc", "clang"])):
        if path and (usable := _probed(path)):
            try:
                library("int works(void) { return 1; }", [], usable)
            except CompilerError as error:
                reason = str(error)
            else:
                return usable
    return reason


def _probed(path: str) -> Compiler | None:
    for machine in _FOR_THIS_MACHINE:
        flags = (*_FLAGS, *machine)
        macros = _run([path, *flags, "-dM", "-E", "-x", "c", os.devnull])
        if macros.returncode == 0:
            return Compiler(path, flags, macros.stdout)
    return None


def library(source: str, definitions: Iterable[str], using: Compiler) -> ctypes.CDLL:
    """Load the library of a source with macros defined (``NAME=VALUE``), from the cache or compiled.

    Raises:
        CompilerError: one line, if the compiler fails, or the library cannot be loaded.
    """
    flags = (*using.flags, *(f"-D{definition}" for definition in definitions))
    identity = "\0".join([_FORMAT, using.path, using.identity, *flags, source])
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
    with tempfile.TemporaryDirectory(prefix="offtrack-") as folder:
        built = Path(folder, "built.so")
        result = _run([using.path, *flags, "-x", "c", "-", "-o", str(built), "-lm"], source)
        if result.returncode != 0:
            raise CompilerError(f"{using.name} failed: {' '.join(result.stderr.split())[:500]}")
        return built.read_bytes()


def _loaded(content: bytes) -> ctypes.CDLL:
    """Load a library from these very bytes: from memory, or else from a temporary folder of this user alone."""
    try:
        return _loaded_from_memory(content)
    except (AttributeError, OSError):  # not Linux, or forbidden
        with tempfile.TemporaryDirectory(prefix="offtrack-") as folder:
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
