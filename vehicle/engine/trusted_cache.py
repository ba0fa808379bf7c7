"""Cache of compiled libraries and derived equations that gives out nothing which another user could have written.

The cache is ``$OFFTRACK_CACHE``, else ``offtrack`` in the user's cache directory. The folder and its files must belong
to this user and be writable by nobody else, and nobody else may be able to rename a folder above it. A file holds its
content and a code of authentication: a hash of key and content with a secret, which lies in the folder and only its
owner can read. A file is opened once, and the bytes that are checked are the bytes that are returned.

A folder or file that is not trusted is named in one warning, and its content is made again. A folder that is full or
read-only has the same effect without a warning. What remains: root, and programs of this same user, are trusted.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import os
import secrets
import shutil
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final, TypeVar

_LOG = logging.getLogger(__name__)

_SECRET: Final = "secret"
_N_SECRET: Final = 32  # [bytes]
_N_CODE: Final = hashlib.sha256().digest_size  # [bytes], at the end of every file
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


def _check(path: Path, status: os.stat_result, *, above: bool = False, others: int = 0o022) -> None:
    """Refuse what belongs to another user or has permissions for ``others``.

    A folder ``above`` the cache may belong to root, and others may write to it if its sticky bit keeps them from
    renaming what is not theirs.
    """
    me = os.geteuid()
    if status.st_uid != me and not (above and status.st_uid == 0):
        raise _RefusedError(f"{path} belongs to user {status.st_uid}, not to you (user {me}). {_ADVICE}")
    if status.st_mode & others and not (above and status.st_mode & stat.S_ISVTX):
        mode = f"{stat.S_IMODE(status.st_mode):o}"
        change = "go-w" if others == 0o022 else "go="
        raise _RefusedError(f"{path} is open to other users (mode {mode}). {_ADVICE}, or run: chmod {change} '{path}'")


def _found(folder: int, name: str) -> bytes | None:
    try:
        whole = _read(folder, name)
    except FileNotFoundError:
        return None
    content, code = whole[:-_N_CODE], whole[-_N_CODE:]
    if not hmac.compare_digest(code, _code(folder, name, content)):
        raise _RefusedError(f"{_path() / name} is damaged, or was not written by offtrack")
    return content


def _stored(folder: int, name: str, content: bytes) -> None:
    _clear(folder)
    _write(folder, name, content + _code(folder, name, content), os.replace)


def _code(folder: int, name: str, content: bytes) -> bytes:
    """Code of authentication of content under the key in its name; the first call makes the secret."""
    with suppress(FileExistsError):  # linked, not renamed: of two processes at once the first one wins
        if _SECRET not in os.listdir(folder):
            _write(folder, _SECRET, secrets.token_bytes(_N_SECRET), os.link)
    secret = _read(folder, _SECRET, others=0o077)
    if len(secret) != _N_SECRET:
        raise _RefusedError(f"{_path() / _SECRET} is damaged. Remove it")
    return hmac.digest(secret, name.partition(".")[0].encode() + content, "sha256")


def _read(folder: int, name: str, *, others: int = 0o022) -> bytes:
    """Content of a file.

    Raises:
        FileNotFoundError: if there is none.
        _RefusedError: if it can not be read, is no regular file, belongs to another user, or is open to ``others``.
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
        _check(path, status, others=others)
        return file.read()


def _write(folder: int, name: str, content: bytes, publish: Callable[..., None]) -> None:
    """Write a file under a temporary name; ``publish``, ``os.replace`` or ``os.link``, gives it its name."""
    temporary = f"{_BUILD}{secrets.token_hex(8)}"
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600, dir_fd=folder)
    try:
        with open(descriptor, "wb") as file:
            file.write(content)
        publish(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    finally:
        with suppress(FileNotFoundError):  # it was renamed
            os.unlink(temporary, dir_fd=folder)


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
