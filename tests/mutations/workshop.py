"""Runs of pytest in forks of one process that has loaded the heavy libraries, in a copy of the tree."""

import importlib
import math
import os
import resource
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import CodeType, FrameType
from typing import NamedTuple

import pytest

_LIBRARIES = "numpy scipy.signal scipy.spatial scipy.optimize casadi control cv2 pydantic pyarrow.parquet hypothesis"
_ROOMS = "vehicle.combination.plant vehicle.rover.plant sensors.messages"  # below those that are mutated
_OPTIONS = "-x -q -n0 -p no:cacheprovider --hypothesis-seed=1 -W ignore::pytest.PytestAssertRewriteWarning"
_WAITING = 4.0  # wall time over processor time, of tests that wait or of a machine that is busy
_LEFT_OUT = shutil.ignore_patterns(".git", ".venv", "runs", "__pycache__", ".*_cache", ".hypothesis")


class Ending(NamedTuple):
    """How a run of pytest ended."""

    code: int  # of exit; negative: a signal
    seconds: float  # of processor time: a busy machine does not change the choice of tests
    functions: list[str]  # "file:qualified name" of what ran, if asked for

    @property
    def timed_out(self) -> bool:
        return self.code == -signal.SIGKILL


class Workshop:
    """A copy of the tree in which files are mutated and tests run."""

    def __init__(self, root: Path, folder: Path) -> None:
        """Copy ``root`` into ``folder``, and load what mutants do not change."""
        self.tree, self._scratch = folder / "tree", folder
        shutil.copytree(root, self.tree, ignore=_LEFT_OUT)
        sys.path[:] = [str(self.tree), *(path for path in sys.path if path not in ("", str(root)))]
        os.environ |= {"PYTHONPATH": str(self.tree), "OPENBLAS_NUM_THREADS": "1"}
        os.chdir(self.tree)
        for name in (*_LIBRARIES.split(), *_ROOMS.split()):
            with suppress(ImportError):
                importlib.import_module(name)

    @contextmanager
    def mutated(self, module: str, text: str) -> Iterator[None]:
        """Write a mutant for the time of the block; Python would take a compiled file of the same second for it."""
        file = self.tree / module
        original = file.read_text(encoding="utf-8")
        try:
            self._write(file, text)
            yield
        finally:
            self._write(file, original)

    @staticmethod
    def _write(file: Path, text: str) -> None:
        file.write_text(text, encoding="utf-8")
        for compiled in (file.parent / "__pycache__").glob(f"{file.stem}.*.pyc"):
            compiled.unlink()

    def run(self, tests: list[str], limit: float, *, traced: bool = False) -> Ending:
        """Run test files until the first failure, for at most ``limit`` seconds of processor time."""
        begin, called, output = time.monotonic(), self._scratch / "called.txt", self._scratch / "output.txt"
        called.write_text("")
        child = os.fork()
        if child == 0:
            try:
                os.setsid()
                resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit), math.ceil(limit)))
                out = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
                for stream in (1, 2):
                    os.dup2(out, stream)
                os._exit(self._tests(tests, called if traced else None))
            finally:
                os._exit(70)
        done, state, used = os.wait4(child, os.WNOHANG)
        while not done and time.monotonic() < begin + _WAITING * limit:
            time.sleep(0.02)
            done, state, used = os.wait4(child, os.WNOHANG)
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # with all processes that the tests have left
        if not done:
            _, state, used = os.wait4(child, 0)
        code, seconds = os.waitstatus_to_exitcode(state), used.ru_utime + used.ru_stime
        return Ending(code, seconds, called.read_text().splitlines())

    def _tests(self, tests: list[str], called: Path | None) -> int:
        for name in [name for name in sys.modules if name.partition(".")[0] == "tests"]:
            del sys.modules[name]  # they are those of the tree that was copied
        seen: dict[int, CodeType] = {}

        def note(frame: FrameType, event: str, argument: object) -> None:
            code = frame.f_code
            if id(code) not in seen:
                seen[id(code)] = code

        if called is not None:
            threading.settrace(note)
            sys.settrace(note)
        code = int(pytest.main([*_OPTIONS.split(), f"--basetemp={self._scratch / 'tmp'}", *tests]))
        sys.settrace(None)
        if called is not None:
            ours = [(c.co_filename.removeprefix(f"{self.tree}/"), c) for c in list(seen.values())]
            names = {f"{file}:{c.co_qualname.partition('.<locals>')[0]}" for file, c in ours if file != c.co_filename}
            called.write_text("\n".join(sorted(names)))
        return code
