"""A case of the fuzz suite: a command or a script in a folder of its own, its result, and what makes it a find."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

SLOWEST: Final = 5.0  # longest time for a refusal [s]
LARGEST: Final = 2048.0  # largest memory of a case [MB]
SPARSE: Final = 3 * 1024**3  # size of a file of holes [bytes]

Special = Literal["fifo", "device", "directory", "symlink loop", "sparse", "missing"]
Tree = dict[str, tuple[int, int, int]]  # mode, size, time of change by path


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One thing to try."""

    kind: str  # the heading under which it is counted
    command: tuple[str, ...] = ()  # arguments of offtrack; none: the script
    script: str = ""  # Python; may set ``outcome``
    files: tuple[tuple[str, bytes | Special], ...] = ()  # by path in the folder; they replace those of the specimen
    specimen: str = ""  # folder of valid files to begin with
    steps: int = 0  # of the loop after which a run is interrupted; 0: it should not begin
    ends: bool = False  # True: a run ends after the steps as if it had timed out, and the command goes on
    own: bool = False  # True: runs code of the user's, which may fail in the loop
    note: str = ""  # what was done to a file

    def place(self, specimens: Path, folder: Path) -> None:
        if self.specimen:
            shutil.copytree(specimens / self.specimen, folder)
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in self.files:
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            _lay(path, content)

    def title(self) -> str:
        what = "offtrack " + " ".join(self.command) if self.command else "script"
        return f"{self.kind}{f' ({self.note})' if self.note else ''}: {what}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    code: int | None = None  # exit code; None: the process died or was stopped
    error: str = ""  # trace of an exception that got out
    out: str = ""
    err: str = ""
    seconds: float = 0.0  # processor time of a command, or of the last statement of a script
    memory: float = 0.0  # largest [MB]
    outcome: str = ""  # of the run

    @property
    def refused(self) -> bool:
        """True if the input was refused."""
        return self.code == 2

    @property
    def ending(self) -> str:
        if self.refused or self.code is None:
            return "refused" if self.refused else "died"
        return self.outcome or {0: "done", 1: "failed", 130: "interrupted"}.get(self.code, "traceback")


def find(result: Result, before: Tree, after: Tree, *, own: bool = False) -> str | None:
    """The fault of a result in one line; None if it has none."""
    said = result.err.strip().splitlines()
    if result.code is None:
        return result.error or "the process died"
    if result.error or "Traceback (most recent call last)" in result.err + result.out:
        return (result.error or result.err or result.out).strip().splitlines()[-1][:300]
    if result.memory > LARGEST:
        return f"takes {result.memory:.0f} MB of memory"
    if "Aborted!" in said or result.code not in (0, 1, 2, 130):
        return f"exit code {result.code}: {' / '.join(said)[:300]}"
    if result.outcome.startswith("failed") and not own and "its process was ended by" not in result.outcome:  # an FMU's
        return f"outcome: {result.outcome}"
    if not result.refused:
        return None
    if not result.error and len(said) != 1 and not result.err.lstrip().startswith("Usage:"):
        return f"{len(said)} lines for a refusal: {' / '.join(said)[:300]}"
    if new := sorted(name for name in after.keys() | before.keys() if before.get(name) != after.get(name)):
        return f"a refusal wrote {', '.join(new[:5])}"
    if result.seconds > SLOWEST:
        return f"a refusal took {result.seconds:.1f} s"
    return None


def tree(folder: Path) -> Tree:
    """State of every file in a folder; nothing is opened."""
    return dict(_states(folder))


def _states(folder: Path) -> Iterator[tuple[str, tuple[int, int, int]]]:
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]  # of Python, which imports a part
        for name in (*folders, *files):
            path = Path(place, name)
            state = path.lstat()
            change = (0, 0) if path.is_dir() and not path.is_symlink() else (state.st_size, state.st_mtime_ns)
            yield str(path.relative_to(folder)), (state.st_mode, *change)


def _lay(path: Path, content: bytes | Special) -> None:
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content == "fifo":
        os.mkfifo(path)
    elif content == "device":
        path.symlink_to("/dev/zero")
    elif content == "directory":
        path.mkdir()
    elif content == "symlink loop":
        path.symlink_to(path.name)
    elif content == "sparse":
        with path.open("wb") as file:
            file.truncate(SPARSE)
