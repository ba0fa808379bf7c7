"""Run a campaign from its file to its tables and report, and give its results as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv as pa_csv

from offtrack.studies.campaigns.campaign import Campaign
from offtrack.studies.campaigns.campaign_page import campaign_page
from offtrack.studies.campaigns.default_campaign import check_faults
from offtrack.studies.campaigns.failures import (
    Cell,
    Search,
    Times,
    badness,
    bisected,
    by,
    cells_of,
    place_of,
    totals,
    unaccepted,
)
from offtrack.studies.campaigns.verdict import Judgement
from offtrack.studies.case import Outcome
from offtrack.studies.pool import RunOptions
from offtrack.studies.run_study import MakeMore, run_study, runs_table
from offtrack.studies.study_figures import write_run_pages
from offtrack.studies.table import Row
from scenarios.results.run_directory import replaced, replacing

_RUNS: Final = "runs"  # name of the tables of runs


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """Results of a campaign."""

    runs: tuple[Judgement, ...]
    cells: tuple[Cell, ...]
    searches: tuple[Search, ...]


def run_campaign(title: str, campaign: Campaign, directory: Path, options: RunOptions) -> Results:
    """Run what the directory does not hold yet of a campaign, and write its tables and report; see `run_study`.

    Raises:
        ValueError: one line, for an invalid scenario, fault or directory, before anything is written.
        KeyboardInterrupt: after the running processes have been stopped; finished runs are kept.
    """
    if not any(campaign.entry_of(case) for case in campaign.cases()):
        raise ValueError("the campaign has no runs with a fault: its entries are about other values and seeds")
    check_faults(campaign)
    results = list[Results]()

    def finish(outcomes: Sequence[Outcome], _: Sequence[Row], make: MakeMore) -> None:
        runs = [campaign.judge(outcome) for outcome in outcomes]
        searches = bisected(campaign, runs, make)
        found = Results(runs=tuple(runs), cells=tuple(cells_of(campaign, runs)), searches=tuple(searches))
        _write(title, campaign, found, directory)
        results.append(found)

    run_study(title, campaign, directory, options, finish=finish)
    return results[0]


def _write(title: str, campaign: Campaign, found: Results, directory: Path) -> None:
    """Write the table of runs (CSV, Parquet), pages of runs, and the report."""
    table = judged_table(found.runs)
    for name, write in ((f"{_RUNS}.csv", pa_csv.write_csv), (f"{_RUNS}.parquet", pq.write_table)):
        with replacing(directory / name) as unfinished:
            write(table, unfinished)
    links = write_run_pages([run.outcome for run in found.runs], directory, _worst(campaign, found.runs))
    page = campaign_page(title, campaign, found.runs, found.cells, found.searches, links)
    replaced(directory / "report.html", page)


def _worst(campaign: Campaign, runs: Sequence[Judgement]) -> list[int]:
    """Runs by their indices: the worst of each fault and of each law, then the worst of each cell, the worst first."""
    order = {id(run): k for k, run in enumerate(runs)}
    first = [max(group, key=badness) for group in by(runs, lambda run: run.fault).values()]
    first += [max(group, key=badness) for group in by(runs, lambda run: place_of(campaign, run)[2]).values()]
    of_cells = [max(group, key=badness) for group in by(runs, lambda run: place_of(campaign, run)).values()]
    return [order[id(run)] for run in (*first, *sorted(of_cells, key=badness, reverse=True))]


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
    broken = unaccepted(campaign, found.cells)
    return {
        "runs": len(found.runs),
        "cells": [_plain_cell(cell, accepted=cell not in broken) for cell in found.cells],
        "all_faults": [_plain_cell(cell, accepted=True) for cell in totals(found.cells)],
        "bisections": [_plain_search(search) for search in found.searches],
        "not_reached": sum(not run.reached for run in found.runs),
    }


def _plain_cell(cell: Cell, *, accepted: bool) -> dict[str, Any]:
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


def _plain_times(times: Times) -> dict[str, Any]:
    known = {"median": times.median, "worst": times.worst}
    plain = {key: None if math.isnan(v) else "never" if math.isinf(v) else round(v, 3) for key, v in known.items()}
    return {**plain, "never": times.never, "runs": times.known}


def _plain_search(search: Search) -> dict[str, Any]:
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
