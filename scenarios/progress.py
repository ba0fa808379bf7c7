"""Progress of long work: one callback type for everything that takes time."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Progress callback: call it with the work done, the total work and a note on the current step."""

    def __call__(self, done: float, total: float, note: str = "", /) -> None:
        """Report that ``done`` of ``total`` units of work are finished."""


def no_progress(done: float, total: float, note: str = "", /) -> None:
    """Ignore all progress reports."""


def part_of(progress: Progress, part: int, parts: int, note: str = "") -> Progress:
    """Progress callback for one of several equal parts of a larger task, in whole percent of the part.

    Args:
        progress: callback of the larger task; called only when the percentage changes.
        part: index of the part, from 0.
        parts: number of parts.
        note: note that replaces an empty note of the part.
    """
    last = -1

    def report(done: float, total: float, detail: str = "", /) -> None:
        nonlocal last
        percent = int(100 * done / total)
        if percent != last:
            last = percent
            progress(100 * part + percent, 100 * parts, detail or note)

    return report
