"""The long run of the fuzz suite: `make fuzz MINUTES=10`, or `python -m tests.fuzz --minutes 10`.

Tries random scenarios, studies, campaigns, uses of environments and hostile files, prints how many and how they ended,
and every find with the command that shows it again. The exit code is 1 if there are finds.
"""

import argparse
import shlex
import shutil
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

from tests.fuzz.case import LARGEST, SLOWEST, Case
from tests.fuzz.draw import drawn
from tests.fuzz.drawn_campaigns import campaigns
from tests.fuzz.drawn_environments import environment_uses
from tests.fuzz.drawn_scenarios import scenario_runs, studies
from tests.fuzz.files import FILES, Read, hostile_files
from tests.fuzz.pool import Tried, try_all
from tests.fuzz.specimens import make

_PERIOD = 10.0  # of the progress line [s]


def main() -> int:
    """Run until the time is over or an interrupt; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("--minutes", type=float, default=10.0, help="how long to try")
    parser.add_argument("--seed", type=int, default=int(time.time()) % 100_000, help="of the first round of cases")
    parser.add_argument("--children", type=int, default=2, help="processes that work on cases")
    parser.add_argument("--only", default="", help="kinds of cases whose name contains this text")
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"), help="folder for the finds")
    arguments = parser.parse_args()
    out = arguments.out.resolve() / time.strftime("%Y%m%d-%H%M%S")
    print(f"seed {arguments.seed}; finds go to {out}; making valid files of every kind ...", flush=True)
    reads = [read for read in FILES if arguments.only in f"file: {read.name}"]
    make(out / "specimens", {read.specimen for read in reads})
    tally = Tally(time.monotonic())
    until, seed = tally.begin + 60.0 * arguments.minutes, arguments.seed
    try:
        while time.monotonic() < until:
            cases = [case for case in _round(seed, reads, out / "specimens") if arguments.only in case.kind]
            places = out / f"round-{seed}", out / "specimens"
            try_all(cases, *places, children=arguments.children, report=tally.add, until=until)
            seed += 1
    except KeyboardInterrupt:
        print("interrupted", flush=True)
    tally.show()
    if not tally.finds:
        shutil.rmtree(out)
    return 1 if tally.finds else 0


def _round(seed: int, reads: Iterable[Read], specimens: Path) -> list[Case]:
    scenarios = [
        *drawn(scenario_runs(), 60, seed),
        *drawn(studies(), 20, seed),
        *drawn(campaigns(), 20, seed),
        *drawn(environment_uses(), 40, seed),
    ]
    files = [case for read in reads for case in drawn(hostile_files(read, specimens), 4, seed)]
    size = max(len(scenarios), len(files))
    order = [(k * size // len(cases), case) for cases in (scenarios, files) for k, case in enumerate(cases)]
    return [case for _, case in sorted(order, key=lambda numbered: numbered[0])]


class Tally:
    """What was tried, by kind and ending, and the finds."""

    def __init__(self, begin: float) -> None:
        self.begin, self._shown = begin, begin
        self.finds: list[Tried] = []
        self._endings: dict[str, Counter[str]] = defaultdict(Counter)
        self._seconds: Counter[str] = Counter()
        self._slowest, self._largest = 0.0, 0.0

    def add(self, tried: Tried) -> None:
        kind, result = tried.case.kind, tried.result
        self._endings[kind][result.ending] += 1
        self._seconds[kind] += result.seconds  # type: ignore[assignment]  # a counter of floats
        self._largest = max(self._largest, result.memory)
        self._slowest = max(self._slowest, result.seconds if result.refused else 0.0)
        if tried.wrong is not None:
            self.finds.append(tried)
            _save(tried)
            print(f"FIND {len(self.finds)}: {tried.wrong}\n  {tried.case.title()}\n  in {tried.folder}", flush=True)
        if time.monotonic() - self._shown > _PERIOD:
            self._shown = time.monotonic()
            print(f"{self._shown - self.begin:6.0f} s: {self._counts()}", flush=True)

    def show(self) -> None:
        for kind, counts in sorted(self._endings.items()):
            endings, total = ", ".join(f"{ending} {number}" for ending, number in counts.most_common()), counts.total()
            print(f"{kind:44s} {total:5d}, {self._seconds[kind] / total:4.1f} s each: {endings}")
        limits = f"slowest refusal {self._slowest:.1f} s (limit {SLOWEST:g}), largest memory {self._largest:.0f} MB"
        print(f"{limits} (limit {LARGEST:.0f})\n{self._counts()}, {time.monotonic() - self.begin:.0f} s")

    def _counts(self) -> str:
        all_, files = (sum(c.total() for k, c in self._endings.items() if k.startswith(s)) for s in ("", "file"))
        return f"{all_ - files} scenarios, {files} hostile files, {len(self.finds)} finds"


def _save(tried: Tried) -> None:
    case, result = tried.case, tried.result
    name = "case.py"
    if case.script:
        (tried.folder / name).write_text(case.script, encoding="utf-8")
    again = f"python {name}" if case.script else shlex.join(["offtrack", *case.command])
    lines = [f"# {case.title()}", f"# {tried.wrong}", f"# interrupted after {case.steps} steps", again, ""]
    text = "\n".join([*lines, *(f"# {line}" for line in f"{result.error}\n{result.err}".splitlines())])
    (tried.folder / "find.txt").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
