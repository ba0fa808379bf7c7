"""A campaign from its file to its tables and report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv as pa_csv

from scenarios.campaigns.applicable import check_faults
from scenarios.campaigns.bisection import Search, bisected
from scenarios.campaigns.campaign import Campaign
from scenarios.campaigns.campaign_page import campaign_page
from scenarios.campaigns.failures import Cell, badness, by, cells_of, place_of
from scenarios.campaigns.verdict import Judgement
from scenarios.results.files import replaced, replacing
from scenarios.studies.case import Outcome
from scenarios.studies.run_options import RunOptions
from scenarios.studies.run_pages import write_run_pages
from scenarios.studies.run_study import MakeMore, run_study
from scenarios.studies.runs_table import runs_table
from scenarios.studies.table import Row

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
