"""Studies whose processes are killed again and again: ``python -m tests.kills.engines [--only pool,dask]``.

Killed commands and workers are started anew, as a cluster would do. In the end every run must be there, the tables must
be those of an undisturbed study, and no more runs may have been begun than there are, and one for each kill.
"""

import argparse
import importlib.util
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Final

from tests.kills.campaign import PATIENCE, ROOT, start

_STUDY: Final = """scenario = "cambered-road"
seeds = [1, 2, 3]
[set]
"course.length" = 100
off_tracking = "truth"
trailer_steering = "{law}"
[vary]
speed_kmh = {speeds}
"""
_STARTS: Final = "starts.txt"
_LAW: Final = """from controllers.trailer_steering.signal_laws import Unsteered

class Counted(Unsteered):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        with open("/proc/self/cmdline") as command, open({path!r}, "a") as starts:
            starts.write("x" * ("popen_loky" in command.read()))  # not of a rehearsal, nor behind an FMU
"""
_SWEEP: Final = ["sweep", "study.toml", "--out", "out"]


# Whether the study is made, and a function that kills one process, which is started again; False: none to kill.
Engine = tuple[Callable[[], bool], Callable[[random.Random], bool]]


@contextmanager
def _pool(folder: Path, word: str = "popen_loky") -> Iterator[Engine]:
    """Worker processes of the command, of which those with the ``word`` in their command are killed."""
    sweep = [*_SWEEP, "--jobs", "2"]
    running = [start(sweep, folder)]

    def is_made() -> bool:
        code = running[0].poll()
        if code == 1:  # a run that was killed twice has failed: the next command makes it again
            running[0].communicate()
            running[0] = start(sweep, folder)
        elif code:
            raise RuntimeError(running[0].communicate()[1].strip()[-500:])
        return code == 0

    def kill(rng: random.Random) -> bool:
        workers = [*_below(running[0].pid, word)]
        if workers:
            os.kill(rng.choice(workers), signal.SIGKILL)
        return bool(workers)

    yield is_made, kill


@contextmanager
def _dask(folder: Path) -> Iterator[Engine]:
    scheduler_file = folder / "scheduler.json"
    words = ["--scheduler-file", str(scheduler_file), "--host", "127.0.0.1"]
    scheduler = _dask_process(folder, "scheduler", *words, "--port", "0", "--no-dashboard")
    workers: list[subprocess.Popen[bytes]] = []

    def add() -> None:
        more = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder / "dask")]
        workers.append(_dask_process(folder, "worker", *words, *more))

    try:
        while not scheduler_file.exists():
            time.sleep(0.1)
        add()
        add()
        command = start([*_SWEEP, "--scheduler", str(scheduler_file)], folder)

        def kill(rng: random.Random) -> bool:
            _end_group(workers.pop(rng.randrange(len(workers))))
            add()
            return True

        yield (lambda: command.poll() is not None), kill
        said = command.communicate(timeout=PATIENCE)[1]
        if command.returncode != 0:
            raise RuntimeError(f"the command ended with {command.returncode}: {said.strip()[-500:]}")
    finally:
        for process in (*workers, scheduler):
            _end_group(process)


ENGINES: Final[Mapping[str, Callable[[Path], AbstractContextManager[Engine]]]] = {
    "pool": _pool,
    "dask": _dask,
    "fmu": partial(_pool, word="offtrack.exchange.fmi_"),  # the host of an FMU, and the proxy behind it
}


def disturbed(engine: str, folder: Path, pauses: tuple[float, float], rng: random.Random) -> tuple[int, float]:
    """Make the study in a folder with kills after pauses of this range [s]; returns their number and the time [s]."""
    begin, kills = time.monotonic(), 0
    with ENGINES[engine](folder) as (is_made, kill):
        due = begin + rng.uniform(*pauses)
        while not is_made():
            time.sleep(0.05)
            if time.monotonic() > due:
                kills += kill(rng)
                due = time.monotonic() + rng.uniform(*pauses)
            if time.monotonic() - begin > 3.0 * PATIENCE:
                raise RuntimeError(f"not made after {3.0 * PATIENCE:g} s")
    return kills, time.monotonic() - begin


def main() -> int:
    """Repeat studies with kills, and compare their tables with an undisturbed one."""
    parser = argparse.ArgumentParser(description="Kill processes of studies.")
    parser.add_argument("--only", default=",".join(ENGINES), help="engines, separated by commas")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pauses", type=float, nargs=2, default=(6.0, 12.0), help="between kills [s]")
    chosen = parser.parse_args()
    engines, rng, wrong = chosen.only.split(","), random.Random(chosen.seed), 0
    if "dask" in engines and importlib.util.find_spec("distributed") is None:
        engines.remove("dask")
        print("dask is left out: the extra cluster is not installed")
    with tempfile.TemporaryDirectory(prefix="offtrack-kills-") as temporary:
        for engine in engines:
            calm = _prepared(Path(temporary) / f"calm-{engine}", engine)
            if start([*_SWEEP, "--jobs", "2"], calm).wait() != 0:
                raise RuntimeError("the undisturbed study fails")
            runs = len(list((calm / "out/cells").glob("*.json")))
            for k in range(chosen.repetitions):
                folder = _prepared(Path(temporary) / f"{engine}{k}", engine)
                kills, seconds = disturbed(engine, folder, tuple(chosen.pauses), rng)
                begun, out = len((folder / _STARTS).read_bytes()), folder / "out"
                checks = {
                    "the table is DIFFERENT": (out / "table.csv").read_bytes() != (calm / "out/table.csv").read_bytes(),
                    "runs are missing": len(list((out / "cells").glob("*.json"))) != runs,
                    "runs were begun twice": begun > runs + kills,
                    "unfinished files are left": any(out.rglob(".*.unfinished")),
                }
                problems = "; ".join(problem for problem, found in checks.items() if found)
                said = f"{kills} kills in {seconds:.0f} s, {begun} of {runs} runs begun: {problems or 'ok'}"
                print(f"{engine}: {said}", flush=True)
                wrong += bool(problems)
    return 1 if wrong else 0


def _prepared(folder: Path, engine: str) -> Path:
    """A folder with the study; of the engine fmu the law is an FMU with a Python process behind it."""
    folder.mkdir()
    law, speeds = ("law.fmu", "[36, 40]") if engine == "fmu" else ("counted:Counted", "[36, 40, 44, 48]")
    (folder / "study.toml").write_text(_STUDY.format(law=law, speeds=speeds), encoding="utf-8")
    (folder / "counted.py").write_text(_LAW.format(path=str(folder / _STARTS)), encoding="utf-8")
    if engine == "fmu":
        exported = start(
            ["fmu", "law", "counted:Counted", "--vehicle", "uk_longer_semitrailer", "--out", "law.fmu"], folder
        )
        if exported.wait() != 0:
            raise RuntimeError(exported.communicate()[1])
    return folder


def _dask_process(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _end_group(process: subprocess.Popen[bytes]) -> None:
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _below(process: int, word: str) -> Iterator[int]:
    """Processes that a process has started, itself or by others, with a word in their command; any may have ended."""
    with suppress(OSError):
        for task in Path(f"/proc/{process}/task").iterdir():
            for pid in (task / "children").read_text().split():
                if word in Path(f"/proc/{pid}/cmdline").read_text():
                    yield int(pid)
                yield from _below(int(pid), word)


if __name__ == "__main__":
    sys.exit(main())
