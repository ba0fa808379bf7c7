"""The user's cache of what takes long to make: it gives out nothing which another user could have written.

The cache is ``$OFFTRACK_CACHE``, else ``offtrack`` in the user's cache directory. The folder must belong to this user
and be writable by nobody else. A file holds its content and a hash of key and content, which tells damage. The files
that were not used for the longest time are removed where all take too much room.

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
    return _in_folder(lambda folder: _found(folder / name))


def store(name: str, content: bytes) -> None:
    """Store content under the name, whole or not at all; replaces what is not trusted."""
    _in_folder(lambda folder: _stored(folder / name, content))


def _in_folder(action: Callable[[Path], ResultT]) -> ResultT | None:
    """Result of the action with the folder; None if that fails or is not trusted."""
    try:
        return action(_opened(_path()))
    except _RefusedError as error:
        warn_once(f"the cache is not used, and what it holds is made again: {error}.")
    except OSError as error:
        _LOG.info("nothing is cached: %s", error)
    return None


def _path() -> Path:
    user_cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get("OFFTRACK_CACHE") or Path(user_cache, "offtrack")).resolve()


def _opened(path: Path) -> Path:
    """The folder, which is made if it is missing.

    Raises:
        OSError: if it can not be made, or belongs to another user, or others can write to it.
    """
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    status, me = path.stat(), os.geteuid()
    if status.st_uid != me:
        raise _RefusedError(f"{path} belongs to user {status.st_uid}, not to you (user {me}). {_ADVICE}")
    if status.st_mode & 0o022:
        mode = f"{stat.S_IMODE(status.st_mode):o}"
        raise _RefusedError(f"{path} is open to other users (mode {mode}). {_ADVICE}, or run: chmod go-w '{path}'")
    return path


def _found(file: Path) -> bytes | None:
    try:
        whole = file.read_bytes()
    except FileNotFoundError:
        return None
    content, stored = whole[:-_N_HASH], whole[-_N_HASH:]
    if stored != _hash(file.name, content):
        raise _RefusedError(f"{file} is damaged")
    with suppress(OSError):  # another system's files have no times
        os.utime(file, ns=(time.time_ns(), file.stat().st_mtime_ns))  # it was used now
    return content


def _stored(file: Path, content: bytes) -> None:
    """Write a file under a temporary name, which then becomes its name."""
    _clear(file.parent, len(content))
    unfinished = file.with_name(f"{_BUILD}{secrets.token_hex(8)}")
    try:
        unfinished.write_bytes(content + _hash(file.name, content))
        unfinished.replace(file)
    finally:
        unfinished.unlink(missing_ok=True)


def _hash(name: str, content: bytes) -> bytes:
    """Hash of content under the key in its name."""
    whole = hashlib.sha256(name.partition(".")[0].encode())
    whole.update(content)
    return whole.digest()


def _clear(folder: Path, room: int) -> None:
    """Remove what killed processes left half-written, and for ``room`` [bytes] the files used longest ago."""
    files: list[tuple[int, int, Path]] = []
    for path in folder.iterdir():
        with suppress(OSError):  # another process removed it
            status = path.stat()
            if not path.name.startswith(_BUILD):
                files.append((status.st_atime_ns, status.st_size, path))
            elif time.time() - status.st_mtime > _ABANDONED:
                path.unlink()
    excess = sum(size for _, size, _ in files) + room - _LARGEST
    for _, size, path in sorted(files):
        if excess <= 0:
            break
        excess -= size
        with suppress(OSError):
            path.unlink()


@cache
def warn_once(message: str) -> None:
    """Log a warning, once in a process and not in worker processes, see :func:`silence`."""
    _LOG.warning("offtrack: %s", message)


def silence() -> None:
    """Log no warnings from here on: for worker processes, whose parent has logged the same ones."""
    _LOG.setLevel(logging.ERROR)
