"""Progress of long work, and the interrupts (SIGINT, SIGTERM) that end it between two steps."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final, Protocol


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


TERMINATED: Final = 128 + signal.SIGTERM  # exit code, as shells count
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
_received: list[int] = []


def interrupt_on_termination() -> None:
    """Let SIGTERM raise KeyboardInterrupt in this process, as Ctrl-C does."""
    signal.signal(signal.SIGTERM, _interrupt)


def terminated() -> bool:
    """True if SIGTERM has interrupted this process."""
    return signal.SIGTERM in _received


def _interrupt(number: int, _: FrameType | None) -> None:
    _received.append(number)
    raise KeyboardInterrupt


@contextmanager
def postponed_interrupts() -> Iterator[Callable[[Progress], Progress]]:
    """Hold an interrupt back to the end of the block, so that what is being written gets complete.

    Yields a function that makes a progress callback raise the interrupt before: between two steps of long work. A
    second interrupt is raised at once. Outside the main thread, which alone receives interrupts, nothing is held back.

    Raises:
        KeyboardInterrupt: at the end, if there was an interrupt and no callback has raised it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda progress: progress
        return
    held: list[signal.Signals] = []
    pending: list[signal.Signals] = []

    def hold(number: int, _: FrameType | None) -> None:
        if held:
            raise KeyboardInterrupt
        held.append(signal.Signals(number))
        pending.append(signal.Signals(number))

    def release() -> None:
        while pending:
            number = pending.pop()
            previous = signal.signal(number, handlers[number])
            try:
                signal.raise_signal(number)
            finally:
                signal.signal(number, previous)

    def checked(progress: Progress) -> Progress:
        def report(done: float, total: float, note: str = "", /) -> None:
            release()
            progress(done, total, note)

        return report

    handlers = {number: signal.signal(number, hold) for number in _SIGNALS}
    try:
        yield checked
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        release()
