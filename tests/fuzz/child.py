"""A case in this process, a worker: modules and compiled plants stay loaded between cases."""

import ast
import io
import os
import resource
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final

import gymnasium.error

from tests.fuzz.case import Case, Result

_ADDRESS_SPACE: Final = 8 * 1024**3  # a reservation beyond it fails instead of filling the machine [bytes]
_LONGEST: Final = 8.0  # of a loop; then it is interrupted [s]
_SHOWN: Final = 20_000  # characters that are kept of an output


@cache
def _prepared() -> "_Loop":
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    return _Loop()


class _Loop:
    """Interrupts the loop of a run after a number of steps, as Ctrl-C does, and notes how it ended.

    Studies run in this process: starting workers takes seconds.
    """

    def __init__(self) -> None:
        import offtrack.commands.cli  # noqa: F401  # now, not in the first case
        from offtrack.studies import pool, trials
        from scenarios.loop.session import Session

        self._advance: Callable[[Any], None] = Session.advance
        Session.advance = lambda session: self._counted(session)  # type: ignore[method-assign, assignment]
        for module in (pool, trials):
            assert vars(module)["each_in_a_worker"]
            vars(module)["each_in_a_worker"] = _each_here
        self.begin(0)

    def begin(self, steps: int, *, ends: bool = False) -> None:
        self._left, self._ends, self._session = steps, ends, None
        self._began: float | None = None

    @property
    def outcome(self) -> str:
        return "" if self._session is None else str(self._session.outcome or "unfinished")

    def _counted(self, session: Any) -> None:
        if self._session is not session:
            self._session, self._steps = session, 0
        if self._began is None:
            self._began = time.perf_counter()
        if (self._steps >= self._left and not self._ends) or time.perf_counter() - self._began > _LONGEST:
            raise KeyboardInterrupt
        self._steps += 1
        self._advance(session)
        if self._ends and self._steps >= self._left and session.outcome is None:
            session.outcome = "timed out"


def _each_here(work: Callable[..., Any], tasks: Any, **_: Any) -> Iterator[tuple[str, Any]]:
    """What `each_in_a_worker` yields, from this process."""
    for key, arguments in tasks.items():
        try:
            yield key, work(*arguments)
        except Exception as error:
            yield key, error


def result_of(case: Case, folder: Path) -> Result:
    watch = _prepared()
    os.chdir(folder)
    watch.begin(case.steps, ends=case.ends)
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # forget the largest memory
    code, error, outcome, clock = 0, "", "", [time.process_time()]
    with _captured() as texts:
        try:
            outcome = _run_script(case.script, clock) if case.script else _run_command(case.command)
        except SystemExit as exit_:
            code = exit_.code if isinstance(exit_.code, int) else int(exit_.code is not None)
        except KeyboardInterrupt:
            code = 130
        except BaseException as refusal:
            is_gym = type(refusal).__module__ == gymnasium.error.__name__  # they have no base class in common
            is_refusal = case.script and (isinstance(refusal, ValueError) or is_gym)
            code, error = (2, "") if is_refusal else (70, traceback.format_exc())
            print(str(refusal) or repr(refusal), file=sys.stderr)
    seconds = time.process_time() - clock[0]
    sys.path[:] = [place for place in sys.path if place != str(folder)]
    os.chdir("/")
    out, err = (text[:_SHOWN] for text in texts)
    ended = outcome or watch.outcome
    return Result(code=code, error=error, out=out, err=err, seconds=seconds, memory=_peak(), outcome=ended)


def _run_command(arguments: tuple[str, ...]) -> str:
    from offtrack.commands.cli import main

    sys.argv = ["offtrack", *arguments]
    main()
    return ""


def _run_script(text: str, clock: list[float]) -> str:
    """Run a script; the clock is set at its last statement, which is the one that is refused."""
    names: dict[str, Any] = {"__name__": "__fuzz__"}
    for statement in ast.parse(text).body:
        clock[0] = time.process_time()
        exec(compile(ast.Module([statement], []), "case.py", "exec"), names)
    return str(names.get("outcome", ""))


@contextmanager
def _captured() -> Iterator[list[str]]:
    """Texts of standard output and error, also those that libraries write."""
    texts: list[str] = []
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        kept = os.dup(1), os.dup(2)
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        sys.stdout, sys.stderr = (io.TextIOWrapper(io.FileIO(fd, "w", closefd=False), "utf-8") for fd in (1, 2))
        try:
            yield texts
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
            for fd, original in zip((1, 2), kept, strict=True):
                os.dup2(original, fd)
                os.close(original)
            for file in (out, err):
                file.seek(0)
                texts.append(file.read(_SHOWN).decode("utf-8", "replace"))


def _peak() -> float:
    """Largest resident memory since the reset [MB]."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmHWM"))
