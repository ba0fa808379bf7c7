"""offtrack: closed-loop co-simulation of vehicles that slip, steered by what their cameras see.

import offtrack

run = offtrack.run("roundabout", seed=1, off_tracking="truth")
run.summary["off_tracking"]["true_rms_m"]
run.to_pandas()
"""

from __future__ import annotations

from offtrack.hidden import check_packages

check_packages()

from offtrack.run import Run, load_run, run  # noqa: E402  # a hidden package must be told before it is imported
from offtrack.session import Session  # noqa: E402
from offtrack.sweep import Sweep, sweep  # noqa: E402

__all__ = ["Run", "Session", "Sweep", "load_run", "run", "sweep"]
