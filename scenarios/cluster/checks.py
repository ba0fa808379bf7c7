"""Checks of a cluster's workers before the first run: offtrack and its libraries, and the rendering of cameras."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from scenarios.catalogue import OFF_TRACKING, SENSOR, resolve
from scenarios.options.scenario import Scenario
from scenarios.studies.case import Case
from scenarios.studies.identity import installed
from sensors.messages import StereoFrame
from vehicle.user_file import shown

if TYPE_CHECKING:
    from distributed import Client

_SAME: Final = "the same is needed everywhere"
_RENDERING: Final = 120.0  # longest time of a check [s]


def check_software(client: Client) -> None:
    """Refuse workers with another offtrack, Python or other libraries than here; lost ones do not count.

    Raises:
        ValueError: one line, with the first difference.
    """
    versions, here = client.run(importlib.metadata.version, "offtrack", on_error="return"), _version()
    for worker, version in _answers(versions):
        if isinstance(version, BaseException):
            raise ValueError(f"worker {worker}: offtrack is not installed there")
        if version != here:
            raise ValueError(f"worker {worker}: it has offtrack {shown(str(version))}, here is {here}; {_SAME}")
    try:
        found: Mapping[str, Any] = client.run(installed, on_error="return")
    except Exception as error:  # whatever the import of another version leads to
        raise ValueError(f"the workers have another offtrack: {shown(str(error).splitlines()[0])}") from None
    for worker, software in _answers(found):
        if software != installed():
            raise ValueError(f"worker {worker}: {difference(software)}; {_SAME}")


def _answers(results: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Results of the workers that are still there."""
    return [(worker, result) for worker, result in results.items() if not isinstance(result, OSError)]


def _version() -> str:
    return importlib.metadata.version("offtrack")


def difference(software: Any) -> str:
    """The first difference of a worker's software from that of this process."""
    if not isinstance(software, tuple):
        return f"its offtrack does not work ({shown(str(software))})"
    (here_python, here), (python, libraries) = json.loads(installed()[1]), json.loads(software[1])
    if python != here_python:
        return f"it has Python {python.split()[0]}, here is {here_python.split()[0]}"
    for name in sorted(here.keys() | libraries.keys()):
        if here.get(name) != libraries.get(name):
            return f"it has {name} {libraries.get(name, '(none)')}, here is {here.get(name, '(none)')}"
    return "its files of offtrack differ from those here"


def check_rendering(client: Client, plugin: str) -> None:
    """Refuse workers on which cameras can not be rendered; one worker of each machine is asked.

    Raises:
        ValueError: one line with the worker and what is missing.
    """
    from scenarios.cluster.workshop import render_problem

    hosts = {worker.rpartition(":")[0]: worker for worker in client.nthreads()}
    asked = {
        worker: client.submit(render_problem, plugin, workers=[worker], pure=False, allow_other_workers=False)
        for worker in hosts.values()
    }
    for worker, future in asked.items():
        if problem := future.result(timeout=_RENDERING):
            raise ValueError(f"worker {worker}: {problem}")


def renders(cases: Iterable[Case]) -> bool:
    """True if a run has cameras that are rendered with OpenGL."""
    seen = set[tuple[str, tuple[str, ...]]]()
    for case in cases:
        if (key := (case.scenario, case.settings)) not in seen:
            seen.add(key)
            scenario = case.resolved()
            if isinstance(scenario, Scenario) and _has_cameras(scenario):
                return True
    return False


def _has_cameras(scenario: Scenario) -> bool:
    sensor = scenario.sensor
    if sensor is None:
        sensor = resolve("off_tracking", scenario.off_tracking, OFF_TRACKING).sensor
    return getattr(resolve("sensor", sensor, SENSOR), "sends", None) is StereoFrame
