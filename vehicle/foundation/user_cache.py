"""The user's cache of what takes long to make: it gives out nothing which another user could have written.

The cache is ``$OFFTRACK_CACHE``, else ``offtrack`` in the user's cache directory. The folder and its files must belong
to this user and be writable by nobody else, and nobody else may be able to rename a folder above it. A file holds its
content and a hash of key and content, which tells damage. A file is opened once, and the bytes that are checked are the
bytes that are returned. The files that were not used for the longest time are removed where all take too much room.

A folder or file that is not trusted is named in one warning, and its content is made again. A folder that is full or
read-only has the same effect without a warning. What remains: root, and programs of this same user, are trusted.
"""

import hashlib
import io
import logging
import os
import pickle
import platform
import secrets
import shutil
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, Final, TypeVar

import numpy as np

_LOG = logging.getLogger(__name__)

FORMAT: Final = "sha256 at the end"  # of the cache's files
_N_HASH: Final = hashlib.sha256().digest_size  # [bytes], at the end of every file
_BUILD: Final = "build-"  # begins the names of files that are being written
_ABANDONED: Final = 3600.0  # age at which the writer of such a file is gone; writing takes a moment [s]
_LARGEST: Final = 500_000_000  # of all files together [bytes]: a dozen worlds of 36 MB
_ADVICE: Final = "Set OFFTRACK_CACHE to a folder that only you can write"

ResultT = TypeVar("ResultT")


class _RefusedError(OSError):
    """A folder or file that is not trusted."""


def sources_hash(package: Path) -> str:
    """Hash of the sources of a package in this folder; empty without sources."""
    found = hashlib.sha256()
    paths = sorted(package.rglob("*.py"))
    for path in paths:
        found.update(f"{path.relative_to(package)}\0".encode() + path.read_bytes())
    return found.hexdigest() if paths else ""


def made_once(make: Callable[..., ResultT], sources: str, **inputs: Any) -> ResultT:
    """Result of ``make`` for the inputs: read from the cache, or computed and stored.

    ``sources`` is the `sources_hash` of all code that has a part in it. Inputs with classes from elsewhere, whose
    sources may change, are not cached; nor is anything without sources.
    """
    name, identity = f"{make.__module__}.{make.__qualname__}", io.BytesIO()
    versions = (platform.python_version(), platform.machine(), np.__version__)
    try:
        _OwnPickler(identity, protocol=pickle.HIGHEST_PROTOCOL).dump((name, sources, versions, inputs))
    except Exception:  # of a user's class, of any kind
        sources = ""
    return kept(identity.getbuffer(), lambda: make(**inputs)) if sources else make(**inputs)


def kept(identity: bytes | memoryview, make: Callable[[], ResultT]) -> ResultT:
    """Result with this identity: read from the cache, or computed and stored by pickle."""
    file = f"{hashlib.sha256(identity).hexdigest()[:32]}.pickle"
    found = cached(file)
    if found is not None:
        made: ResultT = pickle.loads(found)
        return made
    made = make()
    store(file, pickle.dumps(made, protocol=pickle.HIGHEST_PROTOCOL))
    return made


class _OwnPickler(pickle.Pickler):
    """Writes what consists of own classes and of arrays."""

    def persistent_id(self, part: object) -> None:
        """Refuse classes and functions from elsewhere."""
        if isinstance(part, type | FunctionType) and part.__module__.partition(".")[0] not in _KNOWN:
            raise pickle.PicklingError(f"{part} is from elsewhere")


_KNOWN: Final = ("vehicle", "sensors", "numpy", "scipy", "builtins")  # packages of classes that inputs may have


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
        warn_once(f"the cache is not used, and what it holds is made again: {error}.")
    except OSError as error:
        _LOG.info("nothing is cached: %s", error)
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
    _clear(folder, len(content))
    temporary = f"{_BUILD}{secrets.token_hex(8)}"
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600, dir_fd=folder)
    try:
        with open(descriptor, "wb") as file:
            file.write(content)
            file.write(_hash(name, content))
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    finally:
        with suppress(FileNotFoundError):  # it was renamed
            os.unlink(temporary, dir_fd=folder)


def _hash(name: str, content: bytes) -> bytes:
    """Hash of content under the key in its name."""
    whole = hashlib.sha256(name.partition(".")[0].encode())
    whole.update(content)
    return whole.digest()


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
        with suppress(OSError):  # another system's files have no times
            os.utime(descriptor, ns=(time.time_ns(), status.st_mtime_ns))  # it was used now
        return file.read()


def _clear(folder: int, room: int) -> None:
    """Remove what killed processes left half-written, and for ``room`` [bytes] the files used longest ago."""
    files: list[tuple[int, int, str]] = []
    for name in os.listdir(folder):
        with suppress(OSError):  # another process removed it
            status = os.stat(name, dir_fd=folder, follow_symlinks=False)
            if not name.startswith(_BUILD):
                files.append((status.st_atime_ns, status.st_size, name))
            elif time.time() - status.st_mtime > _ABANDONED:
                shutil.rmtree(_path() / name) if (_path() / name).is_dir() else os.unlink(name, dir_fd=folder)
    excess = sum(size for _, size, _ in files) + room - _LARGEST
    for _, size, name in sorted(files):
        if excess <= 0:
            break
        excess -= size
        with suppress(OSError):
            os.unlink(name, dir_fd=folder)


@cache
def warn_once(message: str) -> None:
    """Log a warning, once in a process and not in worker processes, see :func:`silence`."""
    _LOG.warning("offtrack: %s", message)


def silence() -> None:
    """Log no warnings from here on: for worker processes, whose parent has logged the same ones."""
    _LOG.setLevel(logging.ERROR)
