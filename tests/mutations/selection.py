"""Which test files say most about a function: by what ran in a clean run of each of them."""

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from tests.mutations.operators import Mutant
from tests.mutations.workshop import Workshop

_OTHERS = ("architecture", "benchmarks", "fuzz", "oracles", "sensors", "soak", "vehicle")  # tests of other things
_SLOWEST = 45.0  # test file that is looked at, with the trace [s]


@dataclass(frozen=True)
class TestFile:
    """A test file that passes, what runs in it, and its time with the trace, about twice of that without."""

    __test__: ClassVar = False

    name: str
    seconds: float
    functions: frozenset[str]
    text: str

    def distance(self, module: str) -> int:
        """0 for the module's own tests, 1 for those that name it, 2 for others."""
        if Path(self.name).stem == f"test_{Path(module).stem}":
            return 0
        return 1 if re.search(rf"\b{re.escape(module.removesuffix('.py').replace('/', '.'))}\b", self.text) else 2


def test_files(shop: Workshop, kept: Path) -> list[TestFile]:
    """All test files that pass; ``kept`` holds what earlier runs have found, file by file."""
    known = json.loads(kept.read_text()) if kept.exists() else {}
    files = [file for file in sorted((shop.tree / "tests").rglob("test_*.py")) if file.parent.name not in _OTHERS]
    found = []
    for name, text in ((file.relative_to(shop.tree).as_posix(), file.read_text()) for file in files):
        if name not in known:
            code, seconds, functions = shop.run([name], _SLOWEST, traced=True)
            known[name] = {"code": code, "seconds": round(seconds, 2), "functions": functions}
            kept.write_text(json.dumps(known, indent=1))
            print(f"{seconds:6.1f} s, {len(functions):5d} functions, code {code:3d}: {name}", flush=True)
        if known[name]["code"] == 0:
            found.append(TestFile(name, known[name]["seconds"], frozenset(known[name]["functions"]), text))
    return found


def most_specific(tests: Iterable[TestFile], mutant: Mutant, limit: float, count: int) -> list[TestFile]:
    """At most ``count`` files in which the mutant's functions run, all but the first within ``limit`` seconds.

    First come its module's own tests, then those that name the module, then those that run little else.
    """
    functions = {f"{mutant.module}:{user}" for user in mutant.users}
    candidates = [test for test in tests if test.functions & functions]
    chosen: list[TestFile] = []
    for test in sorted(candidates, key=lambda test: (test.distance(mutant.module), len(test.functions))):
        if not chosen or (len(chosen) < count and sum(other.seconds for other in chosen) + test.seconds <= limit):
            chosen.append(test)
    return chosen
