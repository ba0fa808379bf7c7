"""Time and memory of long and large runs: ``python -m tests.benchmarks.scaling`` writes docs/long-and-large.md.

Every run is made in a process of its own, whose processor time and largest memory count. The hour is one run, in parts
of five simulated minutes. Workers share a study of short runs with cameras.
"""

import argparse
import itertools
import json
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import matplotlib.pyplot as plt
import numpy as np

_ROOT: Final = Path(__file__).parents[2]
_RUN: Final = """
import json, resource, sys, tempfile, time
import offtrack
from pathlib import Path
scenario, settings = {!r}, {!r}
begin = time.process_time()
run = offtrack.run(scenario, seed=1, settings=settings)
with tempfile.TemporaryDirectory() as folder:
    ran = time.process_time()
    run.save(Path(folder) / "run")
    saved = time.process_time()
    size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file()) / 2**20
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([run.summary["timing"]["simulated_s"], ran - begin, saved - ran, size, memory]))
"""
_HOUR_CODE: Final = """
import json, time
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from tests.soak.measure import usage
settings = ["course.length=5000", "speed_kmh=4.9", "trailer_steering=path_preview", "reference_unit=false"]
with TrailerSession(assemble(load_scenario("cambered-road", [*settings, "off_tracking=truth"]), 1)) as session:
    while session.outcome is None and session.tick < 3_600_000:
        begin, tick = time.process_time(), session.tick
        while session.outcome is None and session.tick < tick + 300_000:
            session.advance()
        seconds = (session.tick - tick) / 1000
        print(json.dumps([seconds, time.process_time() - begin, 0.0, 0.0, usage().memory]), flush=True)
"""
_WORLD: Final = """
import json, resource, time
from scenarios.assembly.trailer_run import assemble
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
begin = time.process_time()
with TrailerSession(assemble(load_scenario(*{!r}), 1)) as session:
    while session.tick < 5000:
        session.advance()
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([session.tick / 1000, time.process_time() - begin, 0.0, 0.0, memory]))
"""
_STUDY: Final = """
import json, tempfile
from pathlib import Path
from tests.benchmarks.studies import cases, study
with tempfile.TemporaryDirectory() as folder:
    print(json.dumps(study(cases({runs}, "viso_ot"), {jobs}, Path(folder) / "cells")))
"""
_RUNS: Final = 4  # of the study of each number of workers
_TRUTH: Final = {"off_tracking": "truth", "reference_unit": False}


class Cost(NamedTuple):
    """Cost of a run."""

    simulated: float  # [s]
    run: float  # processor time of assembly and loop [s]
    report: float  # processor time of its report [s]
    size: float  # of its files [MB]
    memory: float  # [MB]


# Title, quantity and its values, each with the scenario and settings of its run.
SERIES: Final[dict[str, tuple[str, dict[float, tuple[str, dict[str, Any]]]]]] = {
    "road, no cameras": (
        "length [m]",
        {length: ("cambered-road", _TRUTH | {"course.length": length}) for length in (100.0, 1000.0, 5000.0, 30_000.0)},
    ),
    "road, cameras": (
        "length [m]",
        {
            length: ("cambered-road", {"speed_kmh": 40.0, "course.length": length})
            for length in (50.0, 100.0, 200.0, 400.0)
        },
    ),
    "rover on sand, camera": (
        "length [m]",
        {length: ("rover-slope", {"course.length": length}) for length in (1.0, 2.0, 4.0, 8.0)},
    ),
    "trailers": (
        "number",
        {
            number: ("roundabout", _TRUTH | {"vehicle": vehicle, "trailer_steering": "none"})
            for number, vehicle in ((0, "rigid_truck"), (1, "us_5_axle"), (2, "b_double"), (3, "a_double"))
        },
    ),
}


_LONG: Final = "first five seconds of a road, cameras"
_WORKERS: Final = "workers"
_HOUR: Final = "one hour"
_HEAD: Final = """# Long and large runs

`python -m tests.benchmarks.scaling` writes this page. "Run" is the processor time of a simulated second with the run's
assembly (of the hour: five minutes of the loop alone), "memory" the largest. Two cores that other programs shared:
times vary by a tenth or two. Things beside the road cost nothing that could be measured (density 0.25 to 2).

The road's map has cells of 0.25 m up to 2 km of straight road or 1 km square, beyond an 8000th of the length (3.75 m at
30 km) or a 4096th of a square's side; the ground's mesh 2.5 m up to 750 m, beyond a 300th.

![Time and memory](../.pictures/scaling.png)
"""
_OF_LOOP: Final = ("simulated [s]", "run [s/s]", "memory [MB]")
_OF_RUN: Final = (*_OF_LOOP, "report [s]", "files [MB]")
_OF_WORKERS: Final = ("workers", "wall time of a run [s]", "processor time of a run [s]", "times one worker")


def main() -> int:
    """Measure, and write the page and its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="series whose title contains this; the page keeps the others")
    options = parser.parse_args()
    page = _ROOT / "docs" / "long-and-large.md"
    _, *sections = page.read_text(encoding="utf-8").split("\n## ")
    tables = {title.lower(): table for title, _, table in (section.partition("\n\n") for section in sections)}
    titles = (*SERIES, _LONG, _WORKERS, _HOUR)
    for title in titles:
        if options.only in title:
            tables[title] = _measured(title)
            print(title, tables[title], sep="\n", flush=True)
    parts = (f"\n## {title.capitalize()}\n\n{tables[title]}" for title in titles if title in tables)
    page.write_text(_HEAD + "".join(parts), encoding="utf-8")
    _draw({title: tables[title] for title in titles if title in tables and title != _WORKERS})
    return 0


def _measured(title: str) -> str:
    """Table of a series."""
    if title == _WORKERS:
        costs = [(jobs, *_printed(_STUDY.format(runs=_RUNS, jobs=jobs))[0]) for jobs in (1, 2, 4)]
        first = costs[0][1]
        rows = [(f"{n}", f"{w:.2f}", f"{cpu:.2f}", f"{first / w:.2f}") for n, w, cpu in costs]
        return _table(_OF_WORKERS, rows)
    if title == _HOUR:
        every_five = zip(itertools.count(5.0, 5.0), _printed(_HOUR_CODE))
        return _of_costs("after [min]", (row for row in every_five if row[0] in (5.0, 30.0, 60.0)))
    if title == _LONG:
        runs = ((length, [f"course.length={length}", "speed_kmh=40"]) for length in (100.0, 1000.0, 5000.0, 30_000.0))
        return _of_costs("length [m]", ((n, _printed(_WORLD.format(("cambered-road", s)))[0]) for n, s in runs))
    quantity, given = SERIES[title]
    return _of_costs(quantity, ((value, _printed(_RUN.format(*run))[0]) for value, run in given.items()))


def _printed(code: str) -> list[list[float]]:
    """Lines of JSON that a program prints."""
    done = subprocess.run([sys.executable, "-c", code], cwd=_ROOT, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def _of_costs(quantity: str, costs: Iterable[tuple[float, list[float]]]) -> str:
    rows = []
    for value, numbers in costs:
        c = Cost(*numbers)
        run = (f"{c.simulated:.0f}", f"{c.run / c.simulated:.3f}")
        files = (f"{c.report:.1f}", f"{c.size:.1f}") if c.size else ()
        rows.append((f"{value:g}", *run, f"{c.memory:.0f}", *files))
    return _table((quantity, *(_OF_RUN if len(rows[0]) > len(_OF_LOOP) + 1 else _OF_LOOP)), rows)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([f"| {' | '.join(head)} |", "|---" * len(head) + "|", *lines, ""])


def _draw(tables: dict[str, str]) -> None:
    figure, axes = plt.subplots(2, len(tables), figsize=(3.0 * len(tables), 5.0), layout="constrained")
    for (top, bottom), (title, table) in zip(axes.T, tables.items(), strict=True):
        head, _, *lines = table.splitlines()
        rows = np.array([line.strip("| ").split(" | ") for line in lines], dtype=float)
        top.plot(rows[:, 0], rows[:, 2], "o-", label="run")
        if rows.shape[1] > len(_OF_LOOP) + 1:
            top.plot(rows[:, 0], rows[:, 4] / rows[:, 1], "o-", label="report")
        bottom.plot(rows[:, 0], rows[:, 3], "o-")
        top.set(title=title, ylim=(0.0, 1.1 * top.get_ylim()[1]))
        bottom.set(xlabel=head.strip("| ").split(" | ")[0], ylim=(0.0, 1.1 * bottom.get_ylim()[1]))
    axes[0, 0].legend()
    axes[0, 0].set_ylabel("processor time of\na simulated second [s]")
    axes[1, 0].set_ylabel("memory [MB]")
    figure.savefig(_ROOT / ".pictures" / "scaling.png", dpi=80)


if __name__ == "__main__":
    sys.exit(main())
