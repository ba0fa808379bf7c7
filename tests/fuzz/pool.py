"""Runs of cases in child processes, with limits of time and memory; what dies, hangs or grows is a find."""

from __future__ import annotations

import multiprocessing
import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Final, NamedTuple

from tests.fuzz.case import LARGEST, SLOWEST, Case, Result, find, tree
from tests.fuzz.child import serve
from tests.fuzz.clock import OwnTime, memory

HANG: Final = 60.0  # after that a case is stopped [s]
_START: Final = 120.0  # of a child [s]
_LOOK: Final = 0.2  # time between looks at the memory [s]
_CASES: Final = 400  # of one child
_ROOT: Final = Path(__file__).parents[2]


class Tried(NamedTuple):
    """A case that was tried."""

    case: Case
    result: Result
    wrong: str | None  # what was found, in one line
    folder: Path


class Child:
    """A child process; it is started again when it has died, and after some hundred cases."""

    def __init__(self, specimens: Path, hang: float = HANG) -> None:
        self._specimens, self._hang = specimens, hang
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._cases = 0

    def __enter__(self) -> Child:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """Kill the child and all that it has started."""
        if self._process is not None and self._process.pid is not None:
            _kill(self._process.pid)
            self._process.join()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None

    def try_(self, case: Case, folder: Path) -> Tried:
        """Try a case in ``folder``; one that was only slow or large gets a second chance.

        What is slow because of first imports is quick then, and a fresh child holds no memory of earlier cases.
        """
        tried = self._once(case, folder)
        large = tried.result.memory > LARGEST
        if tried.wrong is not None and (large or (tried.result.code is not None and tried.result.seconds > SLOWEST)):
            if large:
                self.stop()
            shutil.rmtree(folder)
            tried = self._once(case, folder)
        return tried

    def _once(self, case: Case, folder: Path) -> Tried:
        case.place(self._specimens, folder)
        before = tree(folder)
        result = _genuine(case, folder, self._hang) if case.genuine else self._served(case, folder)
        return Tried(case, result, find(result, before, tree(folder), own=case.own), folder)

    def _served(self, case: Case, folder: Path) -> Result:
        pipe = self._started()
        process = self._process
        assert process is not None
        assert process.pid is not None
        clock, largest = OwnTime(process.pid), 0.0
        pipe.send((replace(case, files=()), folder))
        self._cases += 1
        while not pipe.poll(_LOOK):
            largest = max(largest, memory(process.pid))
            if not process.is_alive():
                return self._stopped(f"the process died with exit code {process.exitcode}", largest)
            if largest > 1.2 * LARGEST:
                return self._stopped(f"takes {largest:.0f} MB of memory and was stopped", largest)
            if clock() > self._hang:
                return self._stopped(f"hangs: was stopped after {self._hang:.0f} s", largest)
        try:
            result: Result = pipe.recv()
        except EOFError:
            return self._stopped("the process died", largest)
        return result

    def _stopped(self, why: str, memory: float) -> Result:
        self.stop()
        return Result(error=why, memory=memory)

    def _started(self) -> Connection:
        if self._pipe is not None and self._cases < _CASES and self._process and self._process.is_alive():
            return self._pipe
        self.stop()
        context = multiprocessing.get_context("spawn")  # never forked: a child of a process with OpenGL hangs
        pipe, other = context.Pipe()
        process = context.Process(target=serve, args=(other,))
        process.start()
        other.close()
        self._process, self._pipe, self._cases = process, pipe, 0
        if not pipe.poll(_START) or pipe.recv() != "ready":
            raise RuntimeError("a child did not start")
        return pipe


def try_all(
    cases: Iterable[Case],
    folder: Path,
    specimens: Path,
    *,
    children: int,
    report: Callable[[Tried], None],
    until: float = float("inf"),
    hang: float = HANG,
) -> None:
    """Try cases in several children until there are no more or the time ``until`` (monotonic) has come.

    Folders of finds stay, the others are removed.
    """
    waiting: queue.SimpleQueue[tuple[int, Case]] = queue.SimpleQueue()
    for numbered in enumerate(cases):
        waiting.put(numbered)
    lock, stop, problems = threading.Lock(), threading.Event(), list[BaseException]()

    def work() -> None:
        with Child(specimens, hang) as child:
            while not stop.is_set() and time.monotonic() < until:
                try:
                    number, case = waiting.get_nowait()
                except queue.Empty:
                    return
                tried = child.try_(case, folder / f"{number:05d}")
                if tried.wrong is None:
                    shutil.rmtree(tried.folder)
                with lock:
                    report(tried)

    def guarded() -> None:
        try:
            work()
        except BaseException as problem:
            problems.append(problem)
            stop.set()

    threads = [threading.Thread(target=guarded) for _ in range(children)]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            while thread.is_alive():
                thread.join(0.5)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    if problems:
        raise problems[0]


def _genuine(case: Case, folder: Path, hang: float) -> Result:
    """The command as a process of its own, as a user starts it."""
    program = [sys.executable, "-c", case.script] if case.script else [sys.executable, "-m", "offtrack.commands.cli"]
    process = subprocess.Popen(
        [*program, *case.command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(_ROOT)},  # this checkout
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    watcher = _Watcher(process.pid, hang)
    with watcher:
        out, err = process.communicate()
    if watcher.why:
        return Result(error=watcher.why, memory=watcher.largest)
    code = process.returncode
    return Result(
        code=None if code < 0 else code,
        error=f"died of signal {-code}" if code < 0 else "",
        out=out,
        err=err,
        seconds=watcher.clock(),
        memory=watcher.largest,
    )


class _Watcher:
    """A thread that stops a process that takes too much time or memory."""

    def __init__(self, pid: int, hang: float) -> None:
        self._pid, self._hang, self._over = pid, hang, threading.Event()
        self.clock = OwnTime(pid)
        self.why, self.largest = "", 0.0
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._over.wait(_LOOK):
            self.largest = max(self.largest, memory(self._pid))
            if self.largest > 1.2 * LARGEST:
                self.why = f"takes {self.largest:.0f} MB of memory and was stopped"
            if self.clock() > self._hang:
                self.why = f"hangs: was stopped after {self._hang:.0f} s"
            if self.why:
                _kill(self._pid)
                return


def _kill(pid: int) -> None:
    """Kill a process and all of its session."""
    for kill in (os.killpg, os.kill):
        try:
            kill(pid, signal.SIGKILL)
        except OSError:
            continue
