"""Which faults a scenario can have, found before its runs begin."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from scenarios.assembly.rover import assemble_rover
from scenarios.assembly.trailer import assemble
from scenarios.campaigns.campaign import Campaign
from scenarios.catalogue import FAULT, OFF_TRACKING, SENSOR, resolve
from scenarios.options.rover import RoverScenario
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.options.viso_ot import VisoOtOptions
from scenarios.studies.case import Case

_WITHOUT_CAMERAS: Final = {"off_tracking": "truth", "viso_ot": VisoOtOptions(), "estimator": {}, "sensor": None}


def check_faults(campaign: Campaign) -> None:
    """Refuse a campaign with a fault that its scenario can't have; each is tried once with each of its sensors.

    Raises:
        ValueError: one line.
    """
    tried = set[tuple[str, ...]]()
    for case in campaign.cases():
        entry, axes = campaign.entry_of(case), dict(case.axes)
        key = entry.title if entry else "", axes.get("off_tracking", ""), axes.get("vehicle", "")
        if entry is None or key in tried:
            continue
        tried.add(key)
        if problem := problem_of(case):
            source = f" with off_tracking = {key[1]}: restrict it by 'only'" if key[1] else ""
            raise ValueError(f"fault {entry.title}: {problem.removeprefix('faults: ')}{source}")


def problem_of(case: Case) -> str:
    """Why a run can't have its faults; empty: it can."""
    return problem(case.scenario, case.settings)


def problem(scenario: str, settings: Iterable[str]) -> str:
    """Why a scenario can't have its faults; empty: it can. Cameras, which take seconds, are not opened."""
    settings = list(settings)
    loaded = load_any_scenario(scenario, settings)
    if isinstance(loaded, Scenario) and (images := _images(loaded)) is not None:
        kinds = [resolve("kind", fault.kind, FAULT) for fault in loaded.faults]
        if all(hasattr(kind, "applies_to") and kind.applies_to(images) for kind in kinds):
            return ""
        loaded = loaded.model_copy(update=_WITHOUT_CAMERAS)
    try:
        if isinstance(loaded, RoverScenario):
            assemble_rover(loaded, 1).close()
        else:
            assemble(loaded, 1).close()
    except ValueError as error:
        return str(error)
    return ""


def _images(scenario: Scenario) -> Any:
    """Class of the images of a scenario's cameras; None: its sensor is no camera."""
    sensor = scenario.sensor or resolve("off_tracking", scenario.off_tracking, OFF_TRACKING).sensor
    return getattr(resolve("sensor", sensor, SENSOR), "sends", None)
