"""The soak: `make soak` or `make soak CYCLES=0.2`, or `python -m tests.soak`.

Repeats what programs do again and again, and prints memory, open descriptors, threads and child processes before, in
the middle and after each part. The exit code is 1 if one of them grows in the second half of a part.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from tests.soak.measure import soaked, usage
from tests.soak.parts import PARTS


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.soak")
    parser.add_argument("--cycles", type=float, default=1.0, help="factor on the number of cycles")
    parser.add_argument("--only", default="", help="parts whose name contains this text")
    arguments = parser.parse_args()
    leaks = []
    for part in (part for part in PARTS if arguments.only in part.name):
        cycles, begin, before = max(4, round(arguments.cycles * part.cycles)), time.monotonic(), usage()
        with tempfile.TemporaryDirectory() as folder, part.opened(Path(folder)) as cycle:
            result = soaked(cycle, before, cycles)
        wrong = result.wrong(part.megabytes)
        print(f"{part.name}: {cycles} cycles, {time.monotonic() - begin:.0f} s")
        for when in ("before", "middle", "after"):
            print(f"  {when:7s} {getattr(result, when)}", flush=True)
        if wrong is not None:
            leaks.append(f"{part.name}: {wrong}")
            print(f"  LEAK: {wrong}", flush=True)
    print("\n".join(leaks) or "nothing grows")
    return 1 if leaks else 0


if __name__ == "__main__":
    sys.exit(main())
