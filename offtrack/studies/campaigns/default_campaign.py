"""The campaign over a scenario without a campaign file, and the faults that a scenario can have."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from estimators.off_tracking.viso_ot import VisoOt
from offtrack.studies.campaigns.campaign import FAULTS, Campaign, by_text
from offtrack.studies.campaigns.fault_entry import NONE, FaultEntry
from offtrack.studies.campaigns.verdict import Limit, Requirements
from offtrack.studies.case import Case, Settings
from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.assembly.rover_run import assemble_rover, rover_path
from scenarios.assembly.trailer_run import assemble
from scenarios.catalogue import FAULT, OFF_TRACKING, SENSOR, resolve
from scenarios.options.rover_scenario import RoverScenario
from scenarios.options.scenario import Scenario, load_any_scenario

_WITHOUT_CAMERAS: Final = {"off_tracking": "truth", "viso_ot": VisoOt.Parameters(), "estimator": {}, "sensor": None}


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


_LAWS: Final = ("path_preview", "mpc", "virtual_driver")
_COMPENSATIONS: Final = ("none", "heading", "crab")
_ONSETS: Final = (0.4, 0.6)  # of the planned duration: on the way into a turn, and in it
_DURATION: Final = 2.0  # of each fault [s]
_FOLLOW: Final = 0.5  # limit of the follow point's deviation from the hitch's path [m]
_CROSS: Final = 0.3  # limit of a rover's distance from its path [m]
_QUICK: Final = ("off_tracking", "surrogate")


def default_campaign(
    scenario: str, settings: Settings, laws: tuple[str, ...] | None, seeds: tuple[int, ...] | None
) -> Campaign:
    """A campaign over a scenario by name or file, with ``settings`` in all runs.

    Trailers run without cameras, by the surrogate of their estimator, unless a setting says otherwise.

    Raises:
        ValueError: one line, if the scenario is not valid with the settings.
    """
    texts = [f"{key}={value}" for key, value in settings]
    loaded = load_any_scenario(scenario, texts)
    if isinstance(loaded, Scenario) and _QUICK[0] not in dict(settings):
        settings = (_QUICK, *settings)
    onsets = tuple(round(share * _planned(loaded), 1) for share in _ONSETS)
    kinds = [kind for kind in FAULT if not problem(scenario, [*map("=".join, settings), f"faults={kind}@1+1"])]
    entries = tuple(FaultEntry(kind=kind, onsets=onsets, durations=(_DURATION,)) for kind in kinds)
    of_text = by_text(f"scenario {scenario}", entries)
    law, shipped = ("slip_compensation", _COMPENSATIONS) if isinstance(loaded, RoverScenario) else _STEERED
    return Campaign(
        scenario=scenario,
        fixed=settings,
        axes={FAULTS: (NONE, *of_text), law: laws or shipped},
        seeds=seeds or (1, 2),
        entries=entries,
        of_text=of_text,
        requirements=_requirements(loaded),
    )


_STEERED: Final = ("trailer_steering", _LAWS)


def _planned(scenario: Scenario | RoverScenario) -> float:
    """Time that the course takes at set speed [s]."""
    if isinstance(scenario, RoverScenario):
        return rover_path(scenario).length / scenario.speed
    return course_of(scenario, vehicle_of(scenario)).length / scenario.speed


def _requirements(scenario: Scenario | RoverScenario) -> Requirements:
    if isinstance(scenario, RoverScenario):
        return Requirements(limits=(Limit("slip.cross_track_max_m", high=_CROSS),))
    return Requirements(limits=(Limit("off_tracking.true_max_m", high=_FOLLOW),), detect=1.0, recover=5.0)
