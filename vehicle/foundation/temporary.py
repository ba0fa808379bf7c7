"""Folders for temporary data: removed at the end, or by the next process if this one is killed.

They lie in the folder for temporary files (``TMPDIR``), and are locked as long as their process lives.
"""

import errno
import fcntl
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import gettempdir, mkdtemp
from typing import Final

FULL: Final = (errno.ENOSPC, errno.EDQUOT)
PREFIX: Final = "offtrack-temporary-"  # of their names


def locked(descriptor: int) -> bool | None:
    """Lock an open file or folder until it is closed; False if another process has, None if nobody can here."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # of a network's file system
        return None
    return True


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a new private folder, which is removed at the end; the error of a full disk names where it lies."""
    folder, descriptor = _new_folder()
    try:
        yield folder
    except OSError as error:
        if error.errno in FULL and error.filename is None:
            error.filename = str(folder.parent)
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(descriptor)


def _new_folder() -> tuple[Path, int]:
    """Make a private folder and lock it; those of killed processes are removed first."""
    _remove_left(Path(gettempdir()))
    while True:
        folder = Path(mkdtemp(prefix=PREFIX))
        descriptor = os.open(folder, os.O_RDONLY)
        if locked(descriptor) is not False and folder.exists():
            return folder, descriptor
        os.close(descriptor)  # another process has just taken it for one that was left


def _remove_left(root: Path) -> None:
    """Remove the folders of this user whose processes are gone."""
    for folder in root.glob(f"{PREFIX}*"):
        with suppress(OSError):  # another process was faster
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            try:
                status = os.fstat(descriptor)
                if status.st_uid == os.geteuid() and stat.S_ISDIR(status.st_mode) and locked(descriptor):
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(descriptor)
