"""Progress of long work, and the interrupts (SIGINT, SIGTERM, SIGHUP) that end it between two steps."""

import atexit
import os
import signal
import stat
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
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


_ENDING: Final = (signal.SIGTERM, signal.SIGHUP)  # a request to end; the terminal has gone
_SIGNALS: Final = (signal.SIGINT, *_ENDING)
_received: list[int] = []
_code: list[int] = []  # with which the process ends


def interrupt_on_termination() -> None:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt in this process, as Ctrl-C does; not if ``nohup`` ignores them."""
    atexit.register(_leave)
    for number in _ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


def end_as_terminated() -> None:
    """End with the exit code of shells, if SIGTERM or SIGHUP has interrupted this process."""
    if _received:
        _code.append(128 + _received[0])
        sys.exit(_code[0])


def _leave() -> None:
    """End at last: Python would end itself by SIGINT, if the interrupt passed through the import of a dataclass."""
    if _code:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        os._exit(_code[0])


def _interrupt(number: int, _: FrameType | None) -> None:
    _received.append(number)
    _leave_terminal()
    raise KeyboardInterrupt


def _leave_terminal() -> None:
    """Let output go nowhere if its terminal has gone: an error of it would be in the way of the results."""
    for descriptor in (1, 2):
        with suppress(OSError):  # it is closed
            if not os.isatty(descriptor) and stat.S_ISCHR(os.fstat(descriptor).st_mode):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, descriptor)
                os.close(nowhere)


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
        _leave_terminal()
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

    heeded = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    handlers = {number: signal.signal(number, hold) for number in heeded}
    try:
        yield checked
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        release()
