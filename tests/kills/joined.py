"""Commands that share a study, killed with all their processes again and again: ``python -m tests.kills.joined``.

Each killed command is started anew, as a cluster would do. In the end every run must be there, and the tables must be
those of an undisturbed study.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tests.kills.campaign import start

_STUDY: Final = """scenario = "cambered-road"
seeds = [1, 2, 3]
[set]
"course.length" = 500
off_tracking = "truth"
[vary]
speed_kmh = [40, 50, 60, 70]
trailer_steering = ["none", "command_steer"]
"""
_LEASE: Final = 3.0  # [s]


def joined(folder: Path, *, commands: int, pauses: tuple[float, float], rng: random.Random) -> tuple[int, float]:
    """Make the study in a folder by commands that are killed after pauses of this range [s].

    Returns:
        Number of kills, and the time until one of the commands ended by itself [s].

    Raises:
        RuntimeError: if a command that was not killed fails.
    """
    sweep = ["sweep", "study.toml", "--join", "--lease", f"{_LEASE:g}", "--jobs", "1", "--out", "out"]
    begin, kills = time.monotonic(), 0
    running = [start(sweep, folder) for _ in range(commands)]
    due = time.monotonic() + rng.uniform(*pauses)
    while all(process.poll() is None for process in running):
        time.sleep(0.05)
        if time.monotonic() > due:
            victim = rng.randrange(commands)
            os.killpg(running[victim].pid, signal.SIGKILL)
            running[victim].communicate()
            running[victim] = start(sweep, folder)
            kills, due = kills + 1, time.monotonic() + rng.uniform(*pauses)
    for process in running:
        said = process.communicate()[1]
        if process.returncode != 0:
            raise RuntimeError(f"a command ended with {process.returncode}: {said.strip()[-500:]}")
    return kills, time.monotonic() - begin


def main(arguments: Sequence[str] | None = None) -> int:
    """Repeat studies with kills, and compare their tables with an undisturbed one."""
    parser = argparse.ArgumentParser(description="Kill commands that share a study.")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--commands", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pauses", type=float, nargs=2, default=(6.0, 12.0), help="between kills [s]")
    chosen = parser.parse_args(arguments)
    rng, wrong = random.Random(chosen.seed), 0
    with tempfile.TemporaryDirectory() as temporary:
        calm = Path(temporary) / "calm"
        calm.mkdir()
        (calm / "study.toml").write_text(_STUDY, encoding="utf-8")
        if start(["sweep", "study.toml", "--out", "out"], calm).wait() != 0:
            raise RuntimeError("the undisturbed study fails")
        expected = (calm / "out" / "table.csv").read_text(encoding="utf-8")
        for k in range(chosen.repetitions):
            folder = Path(temporary) / f"{k}"
            folder.mkdir()
            shutil.copy(calm / "study.toml", folder)
            kills, seconds = joined(folder, commands=chosen.commands, pauses=tuple(chosen.pauses), rng=rng)
            same = (folder / "out" / "table.csv").read_text(encoding="utf-8") == expected
            left = [path.name for name in ("claims", "failed") for path in (folder / "out" / name).iterdir()]
            cells = len(list((folder / "out" / "cells").glob("*.json")))
            table = "equal" if same else "DIFFERENT"
            print(f"{kills} kills in {seconds:.0f} s: {cells} runs, table {table}, left: {left}", flush=True)
            wrong += not same or bool(left)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
