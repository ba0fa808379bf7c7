"""A page of finished runs: played together, and their numbers side by side."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

from scenarios.player.encoding import encoded
from scenarios.player.playback import Playback, PlayedRun
from scenarios.player.rover import played_rover, rover_playback
from scenarios.player.trailer import played_trailer, trailer_playback
from scenarios.report.facts import changes, scenario_facts
from scenarios.report.numbers import groups, number_table
from scenarios.report.page import (
    Cell,
    Column,
    Page,
    Player,
    Preformatted,
    Row,
    Section,
    Table,
    outcome_verdict,
    software_section,
)
from scenarios.results.manifest import versions
from scenarios.results.numbers import number_at
from scenarios.results.rover import RoverResult
from scenarios.viewing.finished import FinishedRun

MOST_RUNS = 6  # as many as there are colours


def view_page(runs: Sequence[FinishedRun], links: Sequence[str] = ()) -> str:
    """The page as HTML; ``links`` are the addresses of the runs' own pages, empty where there is none.

    Raises:
        ValueError: one line, if there are too many runs, or both trailers' and rovers'.
    """
    playback = overlaid(runs, links)
    title = " and ".join(run.name for run in runs) if len(runs) < 3 else f"{len(runs)} runs"
    return Page(
        title=title,
        heading=title,
        subtitle="laid over each other, at the same time or after the same distance" if len(runs) > 1 else "",
        sections=[
            Section("Playback", content=[Player(encoded(playback))]),
            Section("Runs", content=[_facts(runs)]),
            Section("Differences", _DIFFERENCES if len(runs) > 1 else "", [differences(runs)]),
            software_section(versions()),
        ],
        wide=True,
    ).html()


_DIFFERENCES = "In brackets: the difference from the first run."


def run_page(run: FinishedRun, values: int) -> str:
    """The page of a run of a study, which has no page of its own: it is played, with about ``values`` values.

    Raises:
        ValueError: one line, if the files of the run do not fit each other.
    """
    scenario = tomllib.loads(run.result.scenario_toml)
    return Page(
        title=run.name,
        heading=run.name,
        subtitle=" · ".join(filter(None, (scenario["name"], scenario_facts(scenario), f"seed {run.result.seed}"))),
        changes=changes(scenario),
        verdict=outcome_verdict(run.result.outcome),
        sections=[
            Section("Playback", content=[Player(encoded(overlaid([run]), values=values))]),
            Section("All numbers", content=[number_table(run.summary)]),
            Section("Resolved scenario", content=[Preformatted(run.result.scenario_toml)], collapsed=True),
        ],
        wide=True,
    ).html()


def overlaid(runs: Sequence[FinishedRun], links: Sequence[str] = ()) -> Playback:
    """One playback of all runs on the first one's ground.

    Raises:
        ValueError: one line, if there are too many runs, or both trailers' and rovers'.
    """
    if len(runs) > MOST_RUNS:
        raise ValueError(f"{len(runs)} runs: a page shows at most {MOST_RUNS} at once; name fewer")
    if len({run.is_rover for run in runs}) > 1:
        raise ValueError("runs of trailers and of rovers can't be laid over each other")
    playbacks = [
        rover_playback(run.result) if isinstance(run.result, RoverResult) else trailer_playback(run.result)
        for run in runs
    ]
    most = max(playbacks, key=lambda playback: len(playback.charts))
    played = [_played(run, link) for run, link in zip(runs, [*links, *[""] * (len(runs) - len(links))], strict=True)]
    played[1:] = [dataclasses.replace(run, lines=()) for run in played[1:]]  # the first one's ground
    return dataclasses.replace(
        playbacks[0],
        title=", ".join(run.name for run in runs),
        runs=tuple(played),
        charts=most.charts,
        readings=most.readings,
    )


def _played(run: FinishedRun, link: str) -> PlayedRun:
    result = run.result
    played = played_rover(result, run.name) if isinstance(result, RoverResult) else played_trailer(result, run.name)
    return dataclasses.replace(played, pictures=run.pictures, link=link)


def differences(runs: Sequence[FinishedRun]) -> Table:
    """Every number of the summaries, and how far the runs differ from the first one."""
    rows: list[Row] = []
    for group, shown in groups().items():
        lines = [_line(f"{group}.{name}", number, runs) for name, number in shown.numbers.items()]
        if known := [line for line in lines if line]:
            rows += [[shown.title], *known]
    return Table((Column("name"), *(Column("number", run.name) for run in runs)), rows)


def _line(path: str, number: Any, runs: Sequence[FinishedRun]) -> Row:
    values = [number_at(run.summary, path) for run in runs]
    if all(value is None for value in values):
        return []
    first = values[0]
    cells: list[str | Cell] = [number.label, number.text(first)]
    for value in values[1:]:
        apart = None if value is None or first is None else number.factor * (value - first)
        cells.append(number.text(value) + ("" if apart is None else f" ({apart:+z.{number.digits}f})"))
    return cells


def _facts(runs: Sequence[FinishedRun]) -> Table:
    return Table(
        (Column("name", "run"), Column("text", "outcome"), Column("text", "of"), Column("note", "changed keys")),
        list(_fact_rows(runs)),
    )


def _fact_rows(runs: Sequence[FinishedRun]) -> Iterator[Row]:
    for run in runs:
        scenario = tomllib.loads(run.result.scenario_toml)
        outcome = Cell(run.result.outcome, "good" if run.result.outcome == "completed" else "bad")
        facts = f"{scenario['name']} · {scenario_facts(scenario)} · seed {run.result.seed}"
        yield [run.name, outcome, facts, changes(scenario).removeprefix("Changed: ")]
