"""Cost of a study's machinery, and its scaling: ``python -m tests.benchmarks.studies --runs 2000``, on a quiet machine.

Overhead: processor time of the study over that of its runs alone (scenario resolved, loop, summary) in one process,
less one. Scaling: wall time with one process over that with two; ``--cameras`` measures it with cameras.
"""

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from offtrack.studies.case import Case
from offtrack.studies.pool import RunOptions, run_cases
from scenarios.loop.runner import run

_FIXED: Final = (  # 11 s simulated: the shorter a run, the more the machinery counts
    *(("reference_unit", "false"), ("course.entry", "20"), ("course.turn_deg", "30"), ("course.exit", "5")),
)
_ALONE: Final = 60  # runs in this process


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--of-one-process", type=int, default=200, help="runs with one process, for the scaling")
    parser.add_argument("--cameras", action="store_true")
    options = parser.parse_args()
    source = "viso_ot" if options.cameras else "truth"
    own = _own_seconds(source)
    with tempfile.TemporaryDirectory(prefix="offtrack-studies-") as folder:
        slow, _ = study(cases(options.of_one_process, source), 1, Path(folder) / "one")
        fast, seconds = study(cases(options.runs, source), 2, Path(folder) / "two")
    print(f"a run alone: {own:.3f} s of processor time; in a study of {options.runs} with 2 processes: {seconds:.3f} s")
    print(f"overhead: {100.0 * (seconds / own - 1.0):.1f} % (bar 10 %)")
    print(f"wall time of a run: {slow:.3f} s with 1 process, {fast:.3f} s with 2: scaling {slow / fast:.2f} (bar 1.8)")
    return 0


def cases(count: int, source: str) -> list[Case]:
    """Short runs of one scenario with this source of the off-tracking."""
    fixed = (*_FIXED, ("off_tracking", source))
    return [Case(scenario="roundabout", fixed=fixed, axes=(), seed=seed) for seed in range(1, count + 1)]


def _own_seconds(source: str) -> float:
    """Processor time of a run alone [s]."""
    first, *others = cases(_ALONE + 1 if source == "truth" else 3, source)
    run(first.resolved(), first.seed)  # imports, and the engine's compilation
    begin = time.process_time()
    for case in others:
        run(case.resolved(), case.seed).summary()
    return (time.process_time() - begin) / len(others)


def study(planned: list[Case], jobs: int, cells: Path) -> tuple[float, float]:
    """Wall time and processor time of a run in a study [s]."""
    begin, before = time.monotonic(), _seconds()
    outcomes = run_cases(planned, cells, RunOptions(jobs=jobs))
    wall = time.monotonic() - begin
    if not all(outcome.completed for outcome in outcomes):
        raise RuntimeError("a run is not completed")
    return wall / len(planned), (_seconds() - before) / len(planned)


def _seconds() -> float:
    """Processor time of this process and of its children that have ended [s]."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


if __name__ == "__main__":
    sys.exit(main())
