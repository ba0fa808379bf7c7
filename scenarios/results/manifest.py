"""Manifest of a run: versions, seed and hashes that identify it."""

from __future__ import annotations

import importlib.metadata
import platform

import cv2

from scenarios.results.rover import RoverResult
from scenarios.results.run_inputs import manifest_entry
from scenarios.results.run_result import RunResult
from vehicle.engine.compiler import engine_name


def manifest(result: RunResult | RoverResult) -> dict[str, object]:
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
