"""offtrack: closed-loop co-simulation of vehicles that slip, steered by what their cameras see.

``offtrack.run("roundabout", off_tracking="truth")`` runs a scenario; ``sweep`` runs grids of them, ``load_run`` reads a
run directory, and a ``Session`` is stepped by hand. The import registers the gymnasium environments:
``gymnasium.make("offtrack/TrailerSteering-v0")``.
"""

from __future__ import annotations

from offtrack.hidden import check_packages

check_packages()

import scenarios.gym_env  # noqa: E402, F401  # registers the environments
from offtrack.run import Run, load_run, run  # noqa: E402  # a hidden package must be told before it is imported
from offtrack.session import Session  # noqa: E402
from offtrack.sweep import Sweep, sweep  # noqa: E402

__all__ = ["Run", "Session", "Sweep", "load_run", "run", "sweep"]
