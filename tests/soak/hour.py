"""Memory of one long run: ``python -m tests.soak.hour [--minutes 60] [--cameras]``.

Prints the resident memory of every simulated minute, how much it grows after the first minutes, and how much is needed
to make the log at the end. The exit code is 1 if memory grows by more than 5 %, or if the log needs more than twice its
own size.
"""

import argparse
import resource
import sys
import time
from typing import Final

import numpy as np

from scenarios.assembly.trailer_run import assemble
from scenarios.loop.trailer_session import TrailerSession
from scenarios.options.scenario import load_scenario
from scenarios.results.run_inputs import RunInputs
from tests.soak.measure import usage
from vehicle.clock import TICK

WARM: Final = 5  # minutes that warm up
LIMIT: Final = 0.05  # growth after that
SIZES: Final = 2.0  # memory to make the log over its size
_OTHER: Final = 50.0  # what the log does not need for its rows: modules, a part of the rows [MB]
_STRAIGHT: Final = ("course.length=5000", "speed_kmh=4.9", "trailer_steering=path_preview", "reference_unit=false")
_TRUTH: Final = ("off_tracking=truth",)
_CAMERAS: Final = (
    *("off_tracking=viso_ot", "rig.rate_hz=2", "rig.width=336", "rig.height=200"),
    *("world.scenery_density=0.02", "world.tarmac_patches=0"),
)


def main() -> int:
    parser = argparse.ArgumentParser(description="Memory of one long run.")
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--cameras", action="store_true")
    arguments = parser.parse_args()
    settings = [*_STRAIGHT, *(_CAMERAS if arguments.cameras else _TRUTH)]
    scenario = load_scenario("cambered-road", settings)
    print(f"cambered-road, {' '.join(settings)}", flush=True)
    memory, begin = [], time.monotonic()
    with TrailerSession(assemble(scenario, 1)) as session:
        for minute in range(1, arguments.minutes + 1):
            while session.outcome is None and session.tick * TICK < 60.0 * minute:
                session.advance()
            now = usage()
            memory.append(now.memory)
            print(f"{minute:3} min: {now}, {time.monotonic() - begin:.0f} s", flush=True)
            if session.outcome is not None:
                print(f"ended: {session.outcome}", flush=True)
                break
        rows = len(session.rows)
        session.outcome = session.outcome or "completed"
        log = session.result(RunInputs()).log
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        session.parts.close()
    grown = max(memory[WARM:], default=np.nan) / memory[min(WARM, len(memory)) - 1] - 1.0
    print(f"{rows} rows of {len(log.signals)} signals; growth after {WARM} min: {100 * grown:.1f} %", end="")
    size = log.rows.nbytes / 2**20
    print(f" (limit {100 * LIMIT:g} %); a log of {size:.0f} MB; with it {usage().memory:.0f} MB", end="")
    print(f", peak {peak:.0f} MB: {peak - memory[-1]:.0f} MB to make it (limit {SIZES * size + _OTHER:.0f} MB)")
    return 1 if grown > LIMIT or peak - memory[-1] > SIZES * size + _OTHER else 0


if __name__ == "__main__":
    sys.exit(main())
