"""offtrack: closed-loop co-simulation of vehicles that slip, steered by what their cameras see.

``offtrack.run("roundabout", off_tracking="truth")`` runs a scenario; ``sweep`` runs grids of them, ``load_run`` reads a
run directory, and a ``Session`` is stepped by hand. The import registers the gymnasium environments:
``gymnasium.make("offtrack/TrailerSteering-v0")``.

The names are imported at their first use: commands and worker processes need none of them. The environments are
registered as soon as gymnasium is imported, too.
"""

from __future__ import annotations

import importlib
import sys
from importlib.abc import MetaPathFinder
from typing import TYPE_CHECKING, Any, Final

from offtrack.hidden import check_packages

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

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


def _register() -> None:
    import gymnasium  # takes as long as all else that a list of commands needs

    for name, observed in _ENVIRONMENTS.items():
        gymnasium.register(
            f"offtrack/{name}",
            entry_point="offtrack.environments.registry:single",
            vector_entry_point="offtrack.environments.registry:vector",
            kwargs={"name": name, **observed},
        )


class _AfterGymnasium(MetaPathFinder):
    """Registers the environments at the end of gymnasium's import."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        """Spec of gymnasium as others find it, with the registration behind its code; None for other modules."""
        if fullname != "gymnasium":
            return None
        others = (finder.find_spec(fullname, path, target) for finder in sys.meta_path if finder is not self)
        spec = next(filter(None, others), None)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                sys.meta_path.remove(self)
                _register()

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec


check_packages()
if "gymnasium" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _AfterGymnasium())


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'offtrack' has no attribute '{name}'")
    return getattr(importlib.import_module(f"offtrack.{_MODULES[name]}"), name)
