"""Interrupts by the keyboard (SIGINT) and by other programs (SIGTERM), which end a command in the same way."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

from scenarios.progress import Progress

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
