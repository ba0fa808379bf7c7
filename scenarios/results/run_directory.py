"""Files that appear complete or not at all, and run directories made of them, to which drawings are added.

Results of an interrupted command carry a hidden list of their files. As long as they are as listed, the next command
may replace the directory.
"""

import hashlib
import json
import os
import re
import shutil
import stat
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from tempfile import gettempdir
from typing import Final

from scenarios.processes import is_alive
from scenarios.progress import postponed_interrupts, raise_interrupts
from vehicle.foundation.temporary import locked
from vehicle.foundation.user_file import reason, shown

_UNFINISHED_FILE: Final = re.compile(r"\..+\.\d+\.unfinished")


def check_new_file(path: Path) -> None:
    """Refuse a name under which no new file can be written; call this before long work.

    Raises:
        ValueError: one line.
    """
    if path.exists():
        raise ValueError(f"{path} exists already: choose another file with --out")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent} to write in; make it, or choose another file")
    if not os.access(path.parent, os.W_OK):
        raise ValueError(f"{path}: no permission to write in {path.parent}: choose another file")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the name of an unfinished file, which on success takes the place of ``path`` and otherwise is removed."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        with _naming(path):
            yield unfinished
            unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Let an error of the system name the path that the user knows; a library that writes names none."""
    try:
        yield
    except OSError as error:
        if error.errno and (error.filename is None or _UNFINISHED in str(error.filename)):
            raise OSError(error.errno, os.strerror(error.errno), str(path)) from error
        raise


def replaced(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def unfinished_files(folder: Path) -> list[Path]:
    """Unfinished files in a folder; if only this process uses it, killed processes have left them."""
    return [path for path in folder.iterdir() if _UNFINISHED_FILE.fullmatch(path.name) and path.is_file()]


@contextmanager
def user_of(folder: Path) -> Iterator[None]:
    """Lock a folder; the lock ends with this process at the latest.

    Raises:
        ValueError: one line, if another process has locked it.
    """
    descriptor = _locked_folder(folder)
    try:
        yield
    finally:
        os.close(descriptor)


def _locked_folder(folder: Path) -> int:
    raise_interrupts()
    descriptor = os.open(folder, os.O_RDONLY)
    if locked(descriptor) is False:
        os.close(descriptor)
        raise ValueError(f"directory {folder}: another process works in it; wait, or choose another")
    return descriptor


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


_LONGEST_NAME: Final = 200
_INTERRUPTED: Final = ".interrupted"  # list of the files of interrupted results
_UNFINISHED: Final = ".unfinished"  # end of the names of hidden folders and files that are being written
_LEAST: Final = 1_000_000  # free space that the smallest results need [bytes]
_claims = threading.local()  # ``held``: descriptors of the locked directories of this thread, by their real paths


def next_run_directory(scenario: str, root: Path = Path("runs")) -> Path:
    """The next ``runs/<scenario>-<n>``: n is 1, or one more than the largest in use."""
    taken = [path.name.removeprefix(f"{scenario}-") for path in root.glob(f"{scenario}-*")]
    return root / f"{scenario}-{1 + max((int(n) for n in taken if n.isdigit()), default=0)}"


@contextmanager
def results_directory(
    out: Path | None, name: str, root: Path = Path("runs"), *, space: float = _LEAST
) -> Iterator[Path]:
    """Yield the directory that a command's results go to: ``out``, or else the next ``root/<name>-<n>``.

    The number is taken at once, so that commands that run at the same time have directories of their own. If nothing
    is written, its directory is removed again.

    Raises:
        ValueError: if the directory can not receive results, see `check_run_directory`.
    """
    if out is not None:
        with claimed(out, space):
            yield out
        return
    check_run_directory(next_run_directory(name, root))
    made = _made(root)
    directory = new_run_directory(name, root)
    try:
        with claimed(directory, space):
            yield directory
    finally:
        _remove_empty([directory, *made])


def new_run_directory(name: str, root: Path = Path("runs")) -> Path:
    """The next directory, made by this process."""
    while True:
        directory = next_run_directory(name, root)
        with suppress(FileExistsError):
            directory.mkdir(parents=True)
            return directory


@contextmanager
def claimed(directory: Path, space: float = _LEAST) -> Iterator[None]:
    """Make a directory for results, and lock it, so that no other process writes there or replaces it meanwhile.

    Inside a block of the same directory it does nothing. At the end an empty directory is removed again. The results
    are expected to take ``space`` [bytes].

    Raises:
        ValueError: if it can not receive results, see `check_run_directory`, another process works in it, or there
            is not enough space.
    """
    real, held = _real(directory), _held()
    if real in held:
        yield
        return
    check_run_directory(directory)
    made = _made(real)
    try:
        held[real] = _locked_folder(directory)
        check_run_directory(directory)  # another process may have ended just now
        if (free := shutil.disk_usage(real).free) < space:
            needed = f"{free / 1e6:.3g} MB are free, and the results may take {space / 1e6:.3g} MB"
            raise ValueError(f"directory {directory}: {needed}: make room, or name a folder on another disk")
        yield
    finally:
        if real in held:
            os.close(held.pop(real))
        _remove_empty(made)


def _held() -> dict[Path, int]:
    held: dict[Path, int] = _claims.__dict__.setdefault("held", {})
    return held


def _made(folder: Path) -> list[Path]:
    """Make a folder; return those that were missing, the folder itself first."""
    missing = [one for one in (folder, *folder.parents) if not one.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return missing


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # it is in use
            folder.rmdir()


def check_run_directory(directory: Path) -> None:
    """Refuse a directory that can not receive a complete run; call this before a long run.

    Raises:
        ValueError: if it is a file, contains anything but interrupted results, can not be replaced, or can not be made.
    """
    name = _real(directory).name
    if len(os.fsencode(name)) > _LONGEST_NAME or not name.isprintable():  # the name of the hidden folder is longer
        rule = f"at most {_LONGEST_NAME} bytes and no control characters"
        raise ValueError(f"directory {shown(name)}: its name must have {rule}")
    if os.path.lexists(directory) and not directory.is_dir():
        raise ValueError(f"{directory} is a file or a broken link: choose another name")
    if directory.is_dir() and any(directory.iterdir()) and not _is_interrupted(directory):
        raise ValueError(f"directory {directory} is not empty: choose another, or remove it first")
    if directory.is_dir() and (directory.is_mount() or directory.samefile(Path.cwd())):
        raise ValueError(f"directory {directory} can not be replaced as a whole: name a new folder inside it")
    parent = next(path for path in _real(directory).parents if os.path.lexists(path))
    if not (parent.is_dir() and os.access(parent, os.W_OK)):
        raise ValueError(f"directory {directory} can not be made: no permission to write in {parent}")


def check_apart(first: Path, second: Path) -> None:
    """Refuse two directories for results of which one is or contains the other.

    Raises:
        ValueError: one line.
    """
    one, other = _real(first), _real(second)
    if one.is_relative_to(other) or other.is_relative_to(one):
        raise ValueError(f"directories {first} and {second}: one contains the other; choose two apart from each other")


def mark_interrupted(folder: Path) -> None:
    """Mark the results in a folder as those of an interrupted command, which may be replaced."""
    _mark(folder, _files(folder))


def mark_complete(folder: Path) -> None:
    """Remove the mark of interrupted results."""
    (folder / _INTERRUPTED).unlink(missing_ok=True)


def _mark(folder: Path, files: dict[str, list[int]]) -> None:
    unfinished = folder / f"{_INTERRUPTED}{_UNFINISHED}"
    unfinished.write_text(json.dumps(files), encoding="utf-8")
    unfinished.replace(folder / _INTERRUPTED)


@contextmanager
def added_as_a_whole(directory: Path) -> Iterator[Path]:
    """Yield a hidden folder in a run directory; on success its files move into it, otherwise they are removed.

    A mark of interrupted results then holds for them as well.
    """
    unfinished = directory / f".{os.getpid()}{_UNFINISHED}"
    unfinished.mkdir()
    try:
        with _naming(directory):
            yield unfinished
        with postponed_interrupts():
            if (directory / _INTERRUPTED).exists():
                _mark(directory, _files(directory) | _files(unfinished))
            for path in unfinished.iterdir():
                path.replace(directory / path.name)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


@contextmanager
def appearing_at_once(directory: Path) -> Iterator[Path]:
    """Yield a hidden folder next to ``directory``; on success it takes that name, otherwise it is removed.

    It takes the place of an empty directory or of interrupted results. What killed processes left of this directory's
    hidden folders is removed.

    Raises:
        ValueError: if the directory has been filled meanwhile; the results then are in one of a similar name.
    """
    with claimed(directory), _naming(directory):
        directory, held = _real(directory), _held()
        _remove_left(directory)
        unfinished = directory.with_name(f".{directory.name}.{os.getpid()}{_UNFINISHED}")
        unfinished.mkdir()
        descriptor = os.open(unfinished, os.O_RDONLY)
        locked(descriptor)  # others see that it is in use
        try:
            yield unfinished
            with postponed_interrupts():
                _rename(unfinished, directory)
                held[directory], descriptor = descriptor, held[directory]  # the claim is on the new folder
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
            os.close(descriptor)


def write_or_rescue(directory: Path, write: Callable[[Path], None], claims: ExitStack) -> tuple[Path, str]:
    """Let ``write`` fill a directory as a whole; return it, and an empty text.

    If the system refuses, as the disk is full or gone, the results go to a new directory in the working directory, the
    folder for temporary files or the home; it is returned with the reason. ``claims`` keeps it locked.

    Raises:
        OSError: if no place takes them; it names the first.
        ValueError: as `appearing_at_once`.
    """
    claims.enter_context(claimed(directory))
    try:
        with appearing_at_once(directory) as folder:
            write(folder)
    except OSError as error:
        for root in (Path.cwd(), Path(gettempdir()), Path.home()):
            with suppress(OSError, ValueError):
                rescued = claims.enter_context(results_directory(None, f"offtrack-{_real(directory).name}", root))
                with appearing_at_once(rescued) as folder:
                    write(folder)
                return rescued, f"{error.filename or directory}: {reason(error)}"
        raise
    return directory, ""


def _real(path: Path) -> Path:
    return Path(os.path.realpath(path))  # Path.resolve raises RuntimeError for links in a circle


def _rename(unfinished: Path, directory: Path) -> None:
    if directory.is_dir() and _is_interrupted(directory):
        shutil.rmtree(directory)
    try:
        unfinished.rename(directory)  # replaces an empty directory, refuses one that has been filled meanwhile
    except OSError:
        kept = next_run_directory(directory.name, directory.parent)
        unfinished.rename(kept)
        raise ValueError(f"directory {directory} has been filled meanwhile: the results are in {kept}") from None


def _is_interrupted(directory: Path) -> bool:
    """True if a directory holds nothing but unchanged results of an interrupted command, or a part of them."""
    try:
        listed = json.loads((directory / _INTERRUPTED).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(listed, dict) and _files(directory).items() <= listed.items()


def _files(folder: Path) -> dict[str, list[int]]:
    """Size and modification time by name of all files but the list of interrupted results and unfinished drawings."""
    names = (path.relative_to(folder) for path in folder.rglob("*") if not path.is_dir())
    results = [name for name in names if name.as_posix() != _INTERRUPTED and not name.parts[0].endswith(_UNFINISHED)]
    status = {name.as_posix(): (folder / name).lstat() for name in results}
    return {name: [one.st_size, one.st_mtime_ns] for name, one in status.items()}


def _remove_left(directory: Path) -> None:
    """Remove hidden folders that killed processes have left of a directory."""
    pattern = re.compile(rf"\.{re.escape(directory.name)}\.(\d+){re.escape(_UNFINISHED)}")
    for folder in directory.parent.iterdir():
        match = pattern.fullmatch(folder.name)
        if match and folder.is_dir() and not folder.is_symlink() and not is_alive(int(match[1])):
            descriptor = os.open(folder, os.O_RDONLY)
            if locked(descriptor):  # not in use on another machine
                shutil.rmtree(folder, ignore_errors=True)
            os.close(descriptor)
