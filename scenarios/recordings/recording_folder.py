"""Base class of the writers of recordings."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from scenarios.results.run_directory import appearing_at_once, mark_interrupted


class RecordingFolder:
    """Folder of a recording, which appears at the end of the block, or not at all after an error.

    Raises:
        ValueError: when the block is entered, if the directory can not be made or contains other files.
    """

    def __init__(self, directory: Path) -> None:
        self._appearing = appearing_at_once(directory)

    def __enter__(self) -> Self:
        self._folder = self._appearing.__enter__()
        self._begin()
        return self

    def _begin(self) -> None:
        """Write what does not change during the recording."""

    def end(self, *, interrupted: bool) -> None:
        """End the recording; the recording of an interrupted run may be replaced."""
        if interrupted:
            mark_interrupted(self._folder)

    def note(self, name: str, line: str) -> None:
        """Write a file of one line besides those of the recording."""
        self._append(name, line)

    def _append(self, name: str, line: str) -> None:
        with (self._folder / name).open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._appearing.__exit__(kind, error, trace)
