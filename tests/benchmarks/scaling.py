"""Time and memory of long and large runs: ``python -m tests.benchmarks.scaling`` writes docs/long-and-large.md.

Every run is made in a process of its own, whose processor time and largest memory count. The hour is one run, in parts
of five simulated minutes. Workers share a study of short runs with cameras.
"""

import argparse
import itertools
import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Final, NamedTuple

import matplotlib.pyplot as plt

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
_HOUR: Final = """
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
_RUNS: Final = 8  # of the study of each number of workers
_WORKERS: Final = (1, 2, 4)
_TRUTH: Final = {"off_tracking": "truth", "reference_unit": False}
_SHORT: Final = {"course.entry": 20.0, "course.turn_deg": 30.0, "course.exit": 5.0}


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
    "things beside the road": (
        "density",
        {density: ("roundabout", _SHORT | {"world.scenery_density": density}) for density in (0.25, 0.5, 1.0, 2.0)},
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
_LONG_ROADS: Final = [
    (length, ("cambered-road", [f"course.length={length}", "speed_kmh=40"])) for length in (100.0, 1000.0, 5000.0, 3e4)
]


def main() -> int:
    """Measure, and write the page and its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="series whose title contains this; nothing is written")
    options = parser.parse_args()
    rows: dict[str, list[tuple[float, Cost]]] = {}
    for title, (_, runs) in SERIES.items():
        if options.only in title:
            rows[title] = [(value, _costs(_RUN.format(*run))[0]) for value, run in runs.items()]
            print(title, *rows[title], sep="\n", flush=True)
    if options.only in _LONG:
        rows[_LONG] = [(length, _costs(_WORLD.format(settings))[0]) for length, settings in _LONG_ROADS]
        print(_LONG, *rows[_LONG], sep="\n", flush=True)
    workers: list[tuple[int, float, float]] = []
    for jobs in _WORKERS if options.only in "workers" else ():
        (wall, seconds), *_ = _printed(_STUDY.format(runs=_RUNS, jobs=jobs))
        workers.append((jobs, wall, seconds))
    print("workers: number, wall time and processor time of a run [s]", *workers, sep="\n", flush=True)
    if options.only in "one hour":
        ends = itertools.count(5.0, 5.0)
        rows["one hour"] = [(next(ends), cost) for cost in _costs(_HOUR)]
        print("one hour", *rows["one hour"], sep="\n", flush=True)
    if not options.only:
        (_ROOT / "docs" / "long-and-large.md").write_text(_page(rows) + _table(workers), encoding="utf-8")
        _draw(rows)
    return 0


def _costs(code: str) -> list[Cost]:
    """Costs that a program prints, one a line."""
    return [Cost(*line) for line in _printed(code)]


def _printed(code: str) -> list[list[float]]:
    """Lines of JSON that a program prints."""
    done = subprocess.run([sys.executable, "-c", code], cwd=_ROOT, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def _table(workers: list[tuple[int, float, float]]) -> str:
    """Table of a study by numbers of workers: wall time and processor time of a run [s]."""
    lines = [
        f"| {jobs} | {wall:.2f} | {seconds:.2f} | {3600.0 / wall:.0f} | {workers[0][1] / wall:.2f} |"
        for jobs, wall, seconds in workers
    ]
    head = "| workers | wall time of a run [s] | its processor time [s] | runs an hour | times one worker |"
    return "\n".join([f"\n## Workers, {_RUNS} runs with cameras\n", head, "|---" * 5 + "|", *lines, ""])


def _unit(title: str) -> str:
    return SERIES[title][0] if title in SERIES else "length [m]" if title == _LONG else "after [min]"


def _page(rows: dict[str, list[tuple[float, Cost]]]) -> str:
    parts = [
        "# Long and large runs\n\n`python -m tests.benchmarks.scaling` measures this and writes this page.\n\n"
        "Processor time of a run with its assembly, of its report, size of its files, largest memory of its process.\n"
        "Of the hour: every five minutes of the loop alone. Two cores that other programs shared: times vary by a"
        " tenth or two.\nThe rendered world is bounded. Its map of the road has cells of 0.25 m up to 2 km of straight"
        " road or 1 km square;\nbeyond, an 8000th of the length, or a 4096th of a square's side (3.75 m at 30 km)."
        " The mesh of the ground has cells\nof 2.5 m near the course up to 750 m, beyond a 300th of the length.\n\n"
        "![Time and memory](../.pictures/scaling.png)\n"
    ]
    for title, series in rows.items():
        head = (
            _unit(title),
            "simulated [s]",
            "run [s]",
            "a simulated second [s]",
            "report [s]",
            "files [MB]",
            "memory [MB]",
        )
        lines = [
            f"| {value:g} | {c.simulated:.0f} | {c.run:.1f} | {c.run / c.simulated:.3f} | {c.report:.1f} "
            f"| {c.size:.1f} | {c.memory:.0f} |"
            for value, c in series
        ]
        parts.append(
            "\n".join([f"\n## {title.capitalize()}\n", f"| {' | '.join(head)} |", "|---" * 7 + "|", *lines, ""])
        )
    return "".join(parts)


def _draw(rows: dict[str, list[tuple[float, Cost]]]) -> None:
    figure, axes = plt.subplots(2, len(rows), figsize=(3.0 * len(rows), 5.0), layout="constrained")
    for (top, bottom), (title, series) in zip(axes.T, rows.items(), strict=True):
        values = [value for value, _ in series]
        top.plot(values, [cost.run / cost.simulated for _, cost in series], "o-", label="run")
        top.plot(values, [cost.report / cost.simulated for _, cost in series], "o-", label="report")
        bottom.plot(values, [cost.memory for _, cost in series], "o-")
        top.set(title=title, ylim=(0.0, 1.1 * top.get_ylim()[1]))
        bottom.set(xlabel=_unit(title), ylim=(0.0, 1.1 * bottom.get_ylim()[1]))
    axes[0, 0].legend()
    axes[0, 0].set_ylabel("processor time of\na simulated second [s]")
    axes[1, 0].set_ylabel("memory [MB]")
    figure.savefig(_ROOT / ".pictures" / "scaling.png", dpi=80)


if __name__ == "__main__":
    sys.exit(main())
