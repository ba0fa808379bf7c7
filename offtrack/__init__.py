"""offtrack: closed-loop co-simulation of vehicles that slip, steered by what their cameras see.

``offtrack.run("roundabout", off_tracking="truth")`` runs a scenario; ``sweep`` runs grids of them, ``load_run`` reads a
run directory, and a ``Session`` is stepped by hand. The import registers the gymnasium environments:
``gymnasium.make("offtrack/TrailerSteering-v0")``.

The names are imported at their first use: commands and worker processes need none of them.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys

if signal.getsignal(signal.SIGINT) is signal.default_int_handler and (
    (sys.argv[:1] == ["-m"] and "offtrack" in sys.orig_argv) or "offtrack" in map(os.path.basename, sys.argv[:1])
):
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # of the command: libraries lose an interrupt of their import

from typing import TYPE_CHECKING, Any, Final

import gymnasium

from offtrack.hidden import check_packages

if TYPE_CHECKING:
    from offtrack.runs import Run, Session, load_run, run
    from offtrack.sweeps import Sweep, sweep

__all__ = ["Run", "Session", "Sweep", "load_run", "run", "sweep"]

_MODULES: Final = {
    "Run": "runs",
    "load_run": "runs",
    "run": "runs",
    "Session": "runs",
    "Sweep": "sweeps",
    "sweep": "sweeps",
}
_ENVIRONMENTS: Final = {  # with their usual observation, which every spec records
    "TrailerSteering-v0": {"observation": "surrogate"},
    "TractorTrailerDriving-v0": {},
    "RoverSteering-v0": {"observation": "surrogate"},
}

check_packages()
for _name, _observed in _ENVIRONMENTS.items():
    gymnasium.register(
        f"offtrack/{_name}",
        entry_point="offtrack.environments.registry:single",
        vector_entry_point="offtrack.environments.registry:vector",
        kwargs={"name": _name, **_observed},
    )


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'offtrack' has no attribute '{name}'")
    return getattr(importlib.import_module(f"offtrack.{_MODULES[name]}"), name)
