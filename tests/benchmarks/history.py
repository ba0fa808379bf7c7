"""Processor times against those of the last recorded commit: ``python -m tests.benchmarks.history``.

Every workload runs in turns in this tree and in a worktree of the other commit, each time in a new process. So a ratio
is of one machine and one moment. ``--record`` appends the ratios to ``history.csv``, which nobody writes by hand.
"""

import argparse
import csv
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np

_TREE: Final = Path(__file__).parents[2]
_RECORD: Final = Path(__file__).with_name("history.csv")
_COLUMNS: Final = ("commit", "against", "workload", "ratio")
# Public interfaces alone, so that older commits have them too. Each runs once to warm up, and once to be measured.
_RUN: Final = "import offtrack; work = lambda: offtrack.run({!r}, seed=1, settings={!r})"
_SHORT: Final = {"course.entry": 20.0, "course.turn_deg": 30.0, "course.exit": 5.0}
_STEPS: Final = """
import gymnasium, numpy, offtrack
from scenarios.options.scenario import load_scenario
given = dict(observation="camera", sensing=load_scenario("roundabout", {!r}), image_scale=1) if {!r} else dict()
e = gymnasium.make_vec("offtrack/TrailerSteering-v0", num_envs={}, **given)
e.reset(seed=1)
action = numpy.zeros(e.action_space.shape, numpy.float32)
work = lambda: [e.step(action) for _ in range({})]
"""
WORKLOADS: Final = {
    "import": "import subprocess, sys; work = lambda: subprocess.run([sys.executable, '-c', 'import offtrack.runs'])",
    "trailer, cameras": _RUN.format("roundabout", _SHORT),
    "trailer, no cameras": _RUN.format("roundabout", _SHORT | {"off_tracking": "truth"}),
    "rover, camera": _RUN.format("rover-slope", {"course.length": 2.0, "surface.slope_from": 0.5}),
    "1024 environments": _STEPS.format([], False, 1024, 50),
    "environment, 84x84": _STEPS.format(["rig.width=84", "rig.height=84"], True, 1, 250),
}
_MEASURED: Final = """
import os
work()
before = os.times()
work()
after = os.times()
print(sum(after[:4]) - sum(before[:4]))  # with children
"""


def main() -> int:
    """Measure, print a table, and record it if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", help="the other commit; the last recorded one by default")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", default="", help="workloads whose name contains this")
    parser.add_argument("--record", action="store_true", help="append the ratios of a committed tree to history.csv")
    options = parser.parse_args()
    if options.record and _git("status", "--porcelain"):
        parser.error("--record: commit first")
    against = _git("rev-parse", "--short=8", options.against or _recorded())
    here = _git("rev-parse", "--short=8", "HEAD")
    rows = []
    print(f"{'workload':22s} {'now [s]':>8s} {against + ' [s]':>12s}  ratio", flush=True)
    with _worktree(against) as other:
        for name in (name for name in WORKLOADS if options.only in name):
            both = np.array([_in_turns(name, other, k) for k in range(options.rounds)])
            ratio = float(np.median(both[:, 0] / both[:, 1]))
            print(f"{name:22s} {np.median(both[:, 0]):8.2f} {np.median(both[:, 1]):12.2f}  {ratio:.2f}", flush=True)
            rows.append((here, against, name, f"{ratio:.3f}"))
    if options.record:
        with _RECORD.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
    return 0


def _recorded() -> str:
    """The commit recorded last."""
    with _RECORD.open(encoding="utf-8") as file:
        return list(csv.DictReader(file, _COLUMNS))[-1]["commit"]


def _in_turns(name: str, other: Path, k: int) -> list[float]:
    """Processor time here and in the other tree [s]; the other one begins every second round."""
    order = [_TREE, other][:: 1 if k % 2 == 0 else -1]
    seconds = {tree: _seconds(name, tree) for tree in order}
    return [seconds[_TREE], seconds[other]]


def _seconds(name: str, tree: Path) -> float:
    """Processor time of a workload in a tree, with its children [s]; NaN if that tree cannot run it."""
    code = [sys.executable, "-c", WORKLOADS[name] + _MEASURED]
    done = subprocess.run(
        code, cwd=tree, env=os.environ | {"PYTHONPATH": str(tree)}, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        print(f"{name}: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
    return float(done.stdout.split()[-1]) if done.returncode == 0 else float("nan")


@contextmanager
def _worktree(commit: str) -> Iterator[Path]:
    """A temporary worktree of a commit."""
    with tempfile.TemporaryDirectory(prefix="offtrack-benchmarks-") as folder:
        tree = Path(folder) / commit
        _git("worktree", "add", "--detach", str(tree), commit)
        try:
            yield tree
        finally:
            _git("worktree", "remove", "--force", str(tree))


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=_TREE, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
