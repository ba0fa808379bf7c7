"""How many small defects do the tests notice? ``python -m tests.mutations --sample 300 --seed 1 --out table.json``.

A runner of its own, because mutmut 3 and cosmic-ray 8 have neither a seeded sample by lines nor a choice and order of
the test files for each module: they would try all mutants of a tree, or run all tests for each.

Each mutant lives in a copy of the tree, and is tried by the few test files that say most about its function. One that
survives has survived these, not all tests. The first run tries every test file once, to see what runs in it.
"""

import argparse
import json
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from tests.mutations.operators import Mutant, mutants
from tests.mutations.selection import TestFile, most_specific, test_files
from tests.mutations.workshop import Workshop

_FOLDERS = "estimators,controllers,scenarios/loop,scenarios/results"
_MERCY = 60.0  # beyond the time of a clean run [s]


def main() -> int:
    """Try a sample of mutants, write the table, and print the survivors and the score."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutations")
    parser.add_argument("--sample", type=int, default=300, help="number of mutants")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--folders", default=_FOLDERS, help="whose modules are mutated, separated by commas")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/mutations.json"), help="the table; a run that was interrupted goes on"
    )
    parser.add_argument("--map", type=Path, help="kept list of what runs in which test file, for later runs")
    parser.add_argument("--part", type=int, default=0, help="of the sample, where several runs share it")
    parser.add_argument("--parts", type=int, default=1, help="their number")
    parser.add_argument("--files", type=int, default=4, help="most test files for a mutant")
    parser.add_argument("--seconds", type=float, default=20.0, help="most time of these files beyond the first")
    options = parser.parse_args()
    out, folders = options.out.resolve(), options.folders.split(",")
    rows: list[dict[str, Any]] = []
    out.parent.mkdir(parents=True, exist_ok=True)
    known: list[dict[str, Any]] = json.loads(out.read_text(encoding="utf-8")) if out.exists() else []
    with tempfile.TemporaryDirectory(prefix="offtrack-mutations-") as name:
        shop = Workshop(Path.cwd(), Path(name))
        tests = test_files(shop, (options.map or out.with_suffix(".map.json")).resolve())
        for mutant in sample(shop.tree, folders, options.sample, options.seed)[options.part :: options.parts]:
            chosen = most_specific(tests, mutant, options.seconds, options.files)
            entry = {key: value for key, value in vars(mutant).items() if key not in ("users", "span")}
            entry |= {"tests": [test.name for test in chosen]}
            same = [row for row in known if entry.items() <= row.items()]
            if not same:
                status, seconds = _tried(shop, mutant, chosen)
                print(f"{len(rows):4d} {seconds:5.1f} s  {status:8s} {mutant}", flush=True)
            rows.append(same[0] if same else entry | {"status": status, "seconds": round(seconds, 1)})
            out.write_text(json.dumps([*rows, *(row for row in known if row not in rows)], indent=1), encoding="utf-8")
    out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    for row in rows:
        if row["status"] == "survived":
            print("survived {module}:{line} {function}: {before!r} -> {after!r}  {tests}".format(**row))
    for folder in (*folders, ""):
        statuses = Counter(row["status"] for row in rows if row["module"].startswith(folder))
        total, survived = statuses.total(), statuses["survived"]
        share = f"{100 * (total - survived) / total:.1f} %" if total else "no mutants"
        print(f"{folder or 'all'}: {total - survived} of {total} noticed, {share}; {statuses['timeout']} by their time")
    return 0


def sample(tree: Path, folders: list[str], count: int, seed: int) -> list[Mutant]:
    """Mutants of all modules in proportion to their lines, shuffled; in a module, all operators are as likely."""
    files = [file for folder in folders for file in sorted((tree / folder).rglob("*.py"))]
    texts = {file.relative_to(tree).as_posix(): file.read_text(encoding="utf-8") for file in files}
    lines = [module for module, text in texts.items() for _ in text.splitlines()]
    offset = random.Random(seed).random()
    drawn = []
    for module, quota in Counter(lines[int((k + offset) * len(lines) / count)] for k in range(count)).items():
        rng, operators, left = random.Random(f"{seed} {module}"), dict[str, list[Mutant]](), quota
        for mutant in mutants(module, texts[module]):
            operators.setdefault(mutant.operator, []).append(mutant)
        groups = [rng.sample(group, len(group)) for group in operators.values()]
        while left and any(groups):
            mutant = rng.choice([group for group in groups if group]).pop()
            if mutant.is_python(texts[module]):
                drawn.append(mutant)
                left -= 1
    return random.Random(seed).sample(drawn, len(drawn))


def _tried(shop: Workshop, mutant: Mutant, tests: list[TestFile]) -> tuple[str, float]:
    """Status of a mutant, and how long that took [s]."""
    if not tests:
        return "survived", 0.0
    text = (shop.tree / mutant.module).read_text(encoding="utf-8")
    with shop.mutated(mutant.module, mutant.applied(text)):
        ending = shop.run([test.name for test in tests], _MERCY + sum(test.seconds for test in tests))
    return "timeout" if ending.timed_out else "killed" if ending.code else "survived", ending.seconds


if __name__ == "__main__":
    sys.exit(main())
