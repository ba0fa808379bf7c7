"""Result of a run of any kind of vehicle, and the manifest that identifies the run."""

import importlib.metadata
import platform
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import cv2

from scenarios.results.log import Log
from scenarios.results.run_inputs import RunInputs, manifest_entry
from scenarios.results.summary_numbers import Paced, Summary, Timing
from vehicle.engine.compiler import engine_name


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result(ABC):
    """The result of a run."""

    kind: ClassVar[str]  # of its vehicle: the ``vehicle_kind`` of its scenario

    scenario: str  # name
    scenario_toml: str  # resolved: runs again identically
    seed: int
    outcome: str  # "completed", "diverged", "failed: …", …
    log: Log
    timing: Timing
    manifest: Mapping[str, str]  # what identifies the run besides seed and signals, such as the hash of its images
    traceback: str = ""  # of the exception that ended the run
    inputs: RunInputs = field(default_factory=RunInputs)  # files and own modules that the scenario names
    paced: Paced | None = None  # deadlines kept and missed; None: the run was not paced

    @abstractmethod
    def summary(self) -> Summary:
        """The run in numbers, ready for JSON: null stands for numbers that do not apply or were not measured."""


def manifest(result: Result) -> dict[str, object]:
    """Versions and hashes that identify the run."""
    return {
        "scenario": result.scenario,
        "seed": result.seed,
        "versions": versions(),
        "signals_sha256": result.log.sha256(),
        **result.manifest,
        **manifest_entry(result.inputs),
    }


def versions() -> dict[str, str]:
    """Versions of the software that determines a run's numbers, and the engine of its vehicle model."""
    installed = {name: importlib.metadata.version(name) for name in ("offtrack", "numpy", "casadi")}
    return {"python": platform.python_version(), **installed, "opencv": cv2.__version__, "engine": engine_name()}
