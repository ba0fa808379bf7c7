"""A campaign run to its report and tables; and the campaign over a scenario without a campaign file."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from offtrack.studies.campaigns import failures
from offtrack.studies.campaigns.campaign import FAULTS, Campaign, by_text
from offtrack.studies.campaigns.campaign_page import campaign_page
from offtrack.studies.campaigns.fault_entry import NONE, FaultEntry
from offtrack.studies.campaigns.verdict import Judgement, Limit, Requirements
from offtrack.studies.case import Outcome, Settings
from offtrack.studies.pool import RunOptions
from offtrack.studies.rehearsal import without_cameras
from offtrack.studies.run_study import MakeMore, run_study, runs_table, write_runs_table
from offtrack.studies.study_figures import write_run_pages
from scenarios.catalogue import FAULT, resolve
from scenarios.loop.runner import KINDS
from scenarios.options.scenario import load_any_scenario
from scenarios.results.run_directory import replaced


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
        if reason := problem(case.scenario, case.settings):
            source = f" with off_tracking = {key[1]}: restrict it by 'only'" if key[1] else ""
            raise ValueError(f"fault {entry.title}: {reason.removeprefix('faults: ')}{source}")


def problem(scenario: str, settings: Iterable[str]) -> str:
    """Why a scenario can't have its faults; empty: it can. Cameras, which take seconds, are not opened."""
    settings = list(settings)
    loaded = load_any_scenario(scenario, settings)
    kind_of_vehicle = KINDS[loaded.vehicle_kind]
    if (images := kind_of_vehicle.images(loaded)) is not None:
        kinds = [resolve("kind", fault.kind, FAULT) for fault in loaded.faults]
        if all(hasattr(kind, "applies_to") and kind.applies_to(images) for kind in kinds):
            return ""
        loaded = without_cameras(loaded)
    try:
        kind_of_vehicle.assemble(loaded, 1).close()
    except ValueError as error:
        return str(error)
    return ""


_ONSETS: Final = (0.4, 0.6)  # of the planned duration: on the way into a turn, and in it
_DURATION: Final = 2.0  # of each fault [s]
_FOLLOW: Final = 0.5  # limit of the follow point's deviation from the hitch's path [m]
_CROSS: Final = 0.3  # limit of a rover's distance from its path [m]
# by the ``vehicle_kind`` of a scenario: key that is varied, its values, other settings of all runs, requirements
_DEFAULTS: Final[Mapping[str, tuple[str, tuple[str, ...], Settings, Requirements]]] = {
    "trailer": (
        "trailer_steering",
        ("path_preview", "mpc", "virtual_driver"),
        (("off_tracking", "surrogate"),),
        Requirements(limits=(Limit("off_tracking.true_max_m", high=_FOLLOW),), detect=1.0, recover=5.0),
    ),
    "rover": (
        "slip_compensation",
        ("none", "heading", "crab"),
        (),
        Requirements(limits=(Limit("slip.cross_track_max_m", high=_CROSS),)),
    ),
}


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
    law, usual, preset, requirements = _DEFAULTS[loaded.vehicle_kind]
    if law in dict(settings):
        usual = (dict(settings)[law],)  # what is set for all runs takes the place of what is usually compared
    duration = KINDS[loaded.vehicle_kind].duration(loaded)
    settings = (*(setting for setting in preset if setting[0] not in dict(settings)), *settings)
    onsets = tuple(round(share * duration, 1) for share in _ONSETS)
    kinds = [kind for kind in FAULT if not problem(scenario, [*map("=".join, settings), f"faults={kind}@1+1"])]
    entries = tuple(FaultEntry(kind=kind, onsets=onsets, durations=(_DURATION,)) for kind in kinds)
    of_text = by_text(f"scenario {scenario}", entries)
    return Campaign(
        scenario=scenario,
        fixed=settings,
        axes={FAULTS: (NONE, *of_text), law: laws or usual},
        seeds=seeds or (1, 2),
        entries=entries,
        of_text=of_text,
        requirements=requirements,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """Results of a campaign."""

    directory: Path
    runs: tuple[Judgement, ...]
    cells: tuple[failures.Cell, ...]
    searches: tuple[failures.Search, ...]


def run_campaign(title: str, campaign: Campaign, directory: Path | None, options: RunOptions) -> Results:
    """Run what the directory does not hold yet of a campaign, and write its tables and report; see `run_study`.

    Raises:
        ValueError: one line, for an invalid scenario, fault or directory, before anything is written.
        KeyboardInterrupt: after the running processes have been stopped; finished runs are kept.
    """
    if not any(campaign.entry_of(case) for case in campaign.cases()):
        raise ValueError("the campaign has no runs with a fault: its entries are about other values and seeds")
    check_faults(campaign)
    results = list[Results]()

    def finish(directory: Path, outcomes: Sequence[Outcome], make: MakeMore) -> None:
        runs = [campaign.judge(outcome) for outcome in outcomes]
        searches, cells = tuple(failures.bisected(campaign, runs, make)), tuple(failures.cells_of(campaign, runs))
        found = Results(directory=directory, runs=tuple(runs), cells=cells, searches=searches)
        _write(title, campaign, found)
        results.append(found)

    run_study(title, campaign, directory, options, finish=finish)
    return results[0]


def _write(title: str, campaign: Campaign, found: Results) -> None:
    """Write the table of runs (CSV, Parquet), pages of runs, and the report."""
    write_runs_table(judged_table(found.runs), found.directory)
    links = write_run_pages([run.outcome for run in found.runs], found.directory, _worst(campaign, found.runs))
    page = campaign_page(title, campaign, found.runs, found.cells, found.searches, links)
    replaced(found.directory / "report.html", page)


def _worst(campaign: Campaign, runs: Sequence[Judgement]) -> list[int]:
    """Runs by their indices: the worst of each fault and of each law, then the worst of each cell, the worst first."""
    order = {id(run): k for k, run in enumerate(runs)}
    place = partial(failures.place_of, campaign)

    def worst(key: Callable[[Judgement], object]) -> list[Judgement]:
        return [max(group, key=failures.badness) for group in failures.by(runs, key).values()]

    cells = sorted(worst(place), key=failures.badness, reverse=True)
    return [order[id(run)] for run in (*worst(lambda run: run.fault), *worst(lambda run: place(run)[2]), *cells)]


def judged_table(runs: Sequence[Judgement]) -> pa.Table:
    """The table of a study's runs with the verdict on each, its reasons and its times."""
    table = runs_table([run.outcome for run in runs])
    columns = {
        "fault": [run.fault for run in runs],
        "verdict": [run.verdict for run in runs],
        "reasons": [run.reasons for run in runs],
        "time_to_detect_s": [run.response.detection for run in runs],
        "time_to_recover_s": [run.response.recovery for run in runs],
        "alarm": [run.response.alarm for run in runs],
    }
    for name, values in columns.items():
        table = table.append_column(name, pa.array(values))
    return table


def results_json(campaign: Campaign, found: Results) -> dict[str, Any]:
    """The results as JSON: infinite times, which never came, are "never"; those that do not apply are null."""
    broken = failures.unaccepted(campaign, found.cells)
    return {
        "runs": len(found.runs),
        "cells": [_plain_cell(cell, accepted=cell not in broken) for cell in found.cells],
        "all_faults": [_plain_cell(cell, accepted=True) for cell in failures.totals(found.cells)],
        "bisections": [_plain_search(search) for search in found.searches],
        "not_reached": sum(not run.reached for run in found.runs),
    }


def _plain_cell(cell: failures.Cell, *, accepted: bool) -> dict[str, Any]:
    low, high = cell.failing.interval()
    worst = cell.worst
    return {
        "fault": cell.place[0],
        "further": cell.place[1],
        "law": cell.place[2],
        "failed": cell.failing.beyond,
        "runs": cell.failing.runs,
        "probability": [round(low, 6), round(high, 6)],
        "outcomes": dict(cell.endings),
        "detection_s": _plain_times(cell.detection),
        "recovery_s": _plain_times(cell.recovery),
        "worst": {"run": worst.outcome.case.title, "verdict": worst.verdict, "reasons": worst.reasons},
        "accepted": accepted,
    }


def _plain_times(times: failures.Times) -> dict[str, Any]:
    known = {"median": times.median, "worst": times.worst}
    plain = {key: None if math.isnan(v) else "never" if math.isinf(v) else round(v, 3) for key, v in known.items()}
    return {**plain, "never": times.never, "runs": times.known}


def _plain_search(search: failures.Search) -> dict[str, Any]:
    return {
        "fault": search.entry.title,
        "of": search.table.of,
        "law": search.law,
        "further": search.further,
        "seed": search.seed,
        "finding": search.finding,
        "smallest": search.bracket[1] if search.finding == "found" else None,
        "passes": search.bracket[0] if search.finding == "found" else None,
        "exceptions": list(search.exceptions),
    }
