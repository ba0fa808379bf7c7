"""Progress of long work, and the interrupts (SIGINT, SIGTERM, SIGHUP) that end it between two steps."""

import os
import signal
import stat
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


_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # Ctrl-C; a request to end; the terminal has gone
_SOON: Final = 0.02  # after which an interrupt is tried again [s]
_TRIES: Final = 100
_LOSING: Final = ("<frozen importlib", "/casadi/", "/pydantic/")  # code that loses it, or makes another error of it
_ending: list[int] = []  # signals that end this process at once
_received: list[int] = []


def end_at_once() -> None:
    """Let interrupts end this process, a command that has nothing to keep yet, without a word; not ignored ones."""
    _ending.extend(number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN)
    for number in _ending:
        signal.signal(number, signal.SIG_DFL)


def raise_interrupts() -> None:
    """Let the interrupts that end a command at once raise KeyboardInterrupt from now on."""
    while _ending:
        signal.signal(_ending.pop(), _interrupt)


def interrupted_code() -> int:
    """Exit code of shells for the signal that has interrupted this process."""
    return 128 + (_received or [signal.SIGINT])[0]


def _interrupt(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    while frame is not None and len(_received) < _TRIES:
        if any(place in frame.f_code.co_filename for place in _LOSING):
            signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(number))
            signal.setitimer(signal.ITIMER_REAL, _SOON)
            return
        frame = frame.f_back
    _leave_terminal()
    for one in _SIGNALS:  # a second one ends the process, unless it is held back
        if signal.getsignal(one) is _interrupt:
            signal.signal(one, signal.SIG_DFL)
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
    held, pending = list[int](), list[int]()

    def hold(number: int, _: FrameType | None) -> None:
        if held:
            raise KeyboardInterrupt
        _leave_terminal()
        held.append(number)
        pending.append(number)

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

    heeded = [int(number) for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    handlers = {number: signal.signal(number, hold) for number in heeded}
    try:
        yield checked
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        release()
