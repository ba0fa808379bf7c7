"""Workers never outlive the command that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from scenarios.interrupts import postponed_interrupts
from scenarios.processes import workers
from scenarios.progress import no_progress

STUCK = """
import time
from scenarios.processes import workers

with workers(2) as pool:
    busy = [pool.submit(time.sleep, 600) for _ in range(2)]
    print(*pool._processes, flush=True)
    busy[0].result()
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
        processes = [int(word) for word in main.stdout.readline().split()]
        assert len(processes) == 2
        time.sleep(0.5)  # they may be starting still
        main.send_signal(number)
        main.wait(30)
    deadline = time.monotonic() + 5.0
    while any(map(is_running, processes)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_running, processes))


def test_a_killed_worker_is_one_line() -> None:
    """The system kills the largest process when memory runs out."""
    with pytest.raises(ChildProcessError, match="a worker process was killed") as caught, workers(1) as pool:
        pool.submit(os.kill, pool.submit(os.getpid).result(), signal.SIGKILL).result()
    assert len(str(caught.value).splitlines()) == 1


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
