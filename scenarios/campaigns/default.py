"""The campaign over a scenario for which there is no file: every fault that it can have, at the default amounts."""

from __future__ import annotations

from typing import Final

from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.assembly.rover import rover_path
from scenarios.campaigns.applicable import problem
from scenarios.campaigns.campaign import FAULTS, Campaign, by_text
from scenarios.campaigns.fault_entry import NONE, FaultEntry
from scenarios.campaigns.requirements import Limit, Requirements
from scenarios.catalogue import FAULT
from scenarios.options.rover import RoverScenario
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.studies.case import Settings

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
