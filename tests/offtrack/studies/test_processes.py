"""Workers never outlive the command that started them."""

import operator
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from offtrack.studies.pool import made_run
from scenarios.processes import WorkerDiedError, as_finished, each_in_a_worker
from scenarios.progress import no_progress, postponed_interrupts

STUCK = """
from scenarios.processes import as_finished

sleep = "import os, time; os.write(1, str(os.getpid()).encode() + bytes([10])); time.sleep(600)"  # a line at once
list(as_finished(exec, [sleep, sleep], jobs=2))
"""


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
        with open(f"/proc/{process}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"  # one that nobody waits for has ended all the same
    except (ProcessLookupError, FileNotFoundError):
        return False


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_the_process_that_started_them(number: signal.Signals) -> None:
    """Killed, it cannot tell them; they are asleep, as in a long run."""
    with subprocess.Popen([sys.executable, "-c", STUCK], stdout=subprocess.PIPE, text=True) as main:
        assert main.stdout is not None
        processes = [int(main.stdout.readline()) for _ in range(2)]
        main.send_signal(number)
        main.wait(30)
    deadline = time.monotonic() + 5.0
    while any(map(is_running, processes)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, processes))


def test_a_killed_worker_is_one_line() -> None:
    """The system kills the largest process when memory runs out."""
    kill = "import os; os.kill(os.getpid(), 9)"
    with pytest.raises(ChildProcessError, match="died twice, at last by SIGKILL, perhaps for lack") as caught:
        list(as_finished(exec, [kill, "pass"], jobs=2))
    assert len(str(caught.value).splitlines()) == 1


_kept: list[bytes] = []


def in_use(blocks: int) -> tuple[int, float]:
    """This process, and its memory [MB] after it has used and freed blocks of 64 kB; one that stays is behind them."""
    used = [bytes([k % 256]) * 65536 for k in range(blocks)]
    _kept.append(bytes(65536))
    del used
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return os.getpid(), pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_worker_returns_the_memory_that_a_task_has_freed() -> None:
    """A block behind the freed ones keeps the C library from returning them, so loky would restart the worker."""
    used = [result for _, result in each_in_a_worker(in_use, {"first": [0], "large": [6000], "next": [0]}, jobs=1)]
    (one, first), (other, large), (another, after) = (result for result in used if isinstance(result, tuple))
    assert large - first > 300.0  # [MB], before it is returned: loky's limit
    assert after - first < 50.0
    assert one == other == another


def test_an_interrupt_waits_for_the_end_of_a_step() -> None:
    """A callback raises it between two steps; without one it comes at the end; a second one comes at once."""
    done = []

    def interrupted(times: int, *, reports: bool) -> None:
        with postponed_interrupts() as checked:
            report = checked(no_progress)
            for _ in range(times):
                signal.raise_signal(signal.SIGINT)
            done.append("step")
            if reports:
                report(1, 2)
            done.append("end")

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs begin without it
    try:
        for times, reports, expected in ((1, True, ["step"]), (1, False, ["step", "end"]), (2, False, [])):
            done.clear()
            with pytest.raises(KeyboardInterrupt):
                interrupted(times, reports=reports)
            assert done == expected
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(
    ("moment", "code", "said"),
    [
        ("signal.raise_signal(2)", -2, ""),  # nothing is there to be kept
        ("raise_interrupts(); import interrupted", 130, "imported"),  # which a library may take for its own error
    ],
)
def test_no_interrupt_of_a_command_is_lost(moment: str, code: int, said: str, tmp_path: Path) -> None:
    text = "import signal\nsignal.raise_signal(2)\nprint('imported')"
    (tmp_path / "interrupted.py").write_text(text, encoding="utf-8")
    script = f"""import signal, time
from scenarios.progress import end_at_once, interrupted_code, raise_interrupts
signal.signal(2, signal.default_int_handler)
end_at_once()
try:
    {moment}
    time.sleep(60)
except KeyboardInterrupt:
    raise SystemExit(interrupted_code())"""
    places = os.pathsep.join([os.getcwd(), str(tmp_path)])
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, timeout=50, env={**os.environ, "PYTHONPATH": places})
    assert (done.returncode, done.stdout.strip(), done.stderr) == (code, said, "")


@pytest.mark.slow
def test_a_process_that_dies_costs_its_own_task_one_more_try(tmp_path: Path) -> None:
    """One task dies at its first try, one at every try, one takes too long; the others are done as if nothing was."""
    once = "import os, pathlib\nmark = pathlib.Path({!r})\n"
    once += "if not mark.exists():\n    mark.touch()\n    os.kill(os.getpid(), 9)"
    tasks: dict[str, tuple[object, ...]] = {
        "dies once": (exec, once.format(str(tmp_path / "mark"))),
        "dies": (exec, "import os\nos.kill(os.getpid(), 11)"),
        "leaves": (os._exit, 7),
        "sleeps": (time.sleep, 60.0),
        "raises": (int, "one"),
        **{f"good {k}": (abs, -k) for k in range(6)},
    }
    results = dict(each_in_a_worker(operator.call, tasks, jobs=2, timeout=3.0))
    assert set(results) == set(tasks)
    assert results["dies once"] is None
    assert [results[f"good {k}"] for k in range(6)] == list(range(6))
    assert isinstance(results["raises"], ValueError)
    for key, line in (
        ("dies", "its process died twice, at last by SIGSEGV"),
        ("leaves", "its process died twice, at last by exit code 7"),
        ("sleeps", "took longer than 3 s"),
    ):
        assert isinstance(results[key], WorkerDiedError)
        assert str(results[key]) == line


@pytest.mark.parametrize(("tracebacks", "calls"), [(["FmuKilledError: a", ""], 2), (["KilledError"] * 2, 2), ([""], 1)])
def test_a_run_whose_part_was_killed_is_tried_once_more(
    tracebacks: list[str], calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system kills the process of an FMU when memory runs out, perhaps only then."""
    made = list[str]()

    def run(*_: object) -> SimpleNamespace:
        made.append(tracebacks[len(made)])
        return SimpleNamespace(traceback=made[-1])

    monkeypatch.setattr("offtrack.studies.pool.run", run)
    scenario: Any = None
    assert made_run(scenario, 1).traceback == tracebacks[-1]
    assert len(made) == calls
