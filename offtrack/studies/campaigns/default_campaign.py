"""The campaign over a scenario without a campaign file, and the faults that a scenario can have."""

from collections.abc import Iterable
from typing import Final, NamedTuple

from estimators.off_tracking.viso_ot import VisoOt
from offtrack.studies.campaigns.campaign import FAULTS, Campaign, by_text
from offtrack.studies.campaigns.fault_entry import NONE, FaultEntry
from offtrack.studies.campaigns.verdict import Limit, Requirements
from offtrack.studies.case import Case, Settings
from scenarios.catalogue import FAULT, resolve
from scenarios.loop.runner import KINDS
from scenarios.options.scenario import load_any_scenario

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
    kind_of_vehicle = KINDS[loaded.vehicle_kind]
    if (images := kind_of_vehicle.images(loaded)) is not None:
        kinds = [resolve("kind", fault.kind, FAULT) for fault in loaded.faults]
        if all(hasattr(kind, "applies_to") and kind.applies_to(images) for kind in kinds):
            return ""
        loaded = loaded.model_copy(update=_WITHOUT_CAMERAS)
    try:
        kind_of_vehicle.assemble(loaded, 1).close()
    except ValueError as error:
        return str(error)
    return ""


class _Default(NamedTuple):
    """Default campaign of a kind of vehicle."""

    law: str  # key that the campaign varies
    laws: tuple[str, ...]  # its values
    settings: Settings  # of all runs, unless the command gives them
    requirements: Requirements


_ONSETS: Final = (0.4, 0.6)  # of the planned duration: on the way into a turn, and in it
_DURATION: Final = 2.0  # of each fault [s]
_FOLLOW: Final = 0.5  # limit of the follow point's deviation from the hitch's path [m]
_CROSS: Final = 0.3  # limit of a rover's distance from its path [m]
_DEFAULTS: Final = {
    "trailer": _Default(
        law="trailer_steering",
        laws=("path_preview", "mpc", "virtual_driver"),
        settings=(("off_tracking", "surrogate"),),
        requirements=Requirements(limits=(Limit("off_tracking.true_max_m", high=_FOLLOW),), detect=1.0, recover=5.0),
    ),
    "rover": _Default(
        law="slip_compensation",
        laws=("none", "heading", "crab"),
        settings=(),
        requirements=Requirements(limits=(Limit("slip.cross_track_max_m", high=_CROSS),)),
    ),
}  # by the ``vehicle_kind`` of a scenario


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
    default, duration = _DEFAULTS[loaded.vehicle_kind], KINDS[loaded.vehicle_kind].duration(loaded)
    settings = (*(setting for setting in default.settings if setting[0] not in dict(settings)), *settings)
    onsets = tuple(round(share * duration, 1) for share in _ONSETS)
    kinds = [kind for kind in FAULT if not problem(scenario, [*map("=".join, settings), f"faults={kind}@1+1"])]
    entries = tuple(FaultEntry(kind=kind, onsets=onsets, durations=(_DURATION,)) for kind in kinds)
    of_text = by_text(f"scenario {scenario}", entries)
    return Campaign(
        scenario=scenario,
        fixed=settings,
        axes={FAULTS: (NONE, *of_text), default.law: laws or default.laws},
        seeds=seeds or (1, 2),
        entries=entries,
        of_text=of_text,
        requirements=default.requirements,
    )
