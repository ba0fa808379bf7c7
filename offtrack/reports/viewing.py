"""Finished runs, rebuilt from their files: played together in one page, their numbers side by side."""

from __future__ import annotations

import base64
import binascii
import dataclasses
import html
import json
import re
import tomllib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from offtrack.reports.page import (
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
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.playback import Picture, Playback
from offtrack.reports.run_writer import KINDS
from offtrack.reports.sections import changes, groups, number_table, scenario_facts
from scenarios.options.scenario import load_any_scenario
from scenarios.results.log import read_log
from scenarios.results.run_summary import Result, versions
from scenarios.results.summary_numbers import number_at
from vehicle.foundation.user_file import FileKind, read_text, shown

_ELEMENT: Final = re.compile(r'<(\w+)[^>]* id="playback-(table|numbers|pictures)">(.*?)</\1>', re.DOTALL)
_MOST: Final = 200_000_000  # bytes of a page, or of its numbers, that are read


def pictures_of_page(path: Path) -> tuple[Picture, ...]:
    """The pictures with their strokes; none if the page is missing, or is not of this version."""
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(_MOST)
        parts = {match[2]: match[3] for match in _ELEMENT.finditer(text)}
        table = json.loads(html.unescape(parts["table"]))["runs"][0]["pictures"]
        data = zlib.decompressobj(wbits=31).decompress(base64.b64decode(parts["numbers"]), _MOST)
        return _pictures(table, data, parts["pictures"].split("\n"))
    except (OSError, KeyError, IndexError, TypeError, ValueError, binascii.Error, zlib.error):
        return ()


def _pictures(table: dict[str, Any], data: bytes, lines: list[str]) -> tuple[Picture, ...]:
    place, counts = table["strokes"], table["counts"]
    strokes = np.frombuffer(data, "<i2", place["count"], place["at"]).reshape(-1, 4).astype(np.float32) / 8.0 - 0.5
    ends = np.cumsum([0, *counts])
    pictures = []
    for k, time in enumerate(table["times"]):
        jpeg = base64.b64decode(lines[table["first"] + k], validate=True)
        caption = table["captions"][k] if table["captions"] else ""
        drawn = tuple(table["lines"][k]) if table["lines"] else ()
        pictures.append(Picture(float(time), jpeg, strokes[ends[k] : ends[k + 1]], str(caption), drawn))
    return tuple(pictures)


_NEEDED = ("summary.json", "scenario.toml", "signals.parquet")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FinishedRun:
    """A finished run as its directory tells it."""

    name: str
    directory: Path
    summary: Mapping[str, Any]
    result: Result
    pictures: tuple[Picture, ...] = ()  # those of its page


def finished_run(directory: Path, name: str) -> FinishedRun:
    """The run of a directory.

    Raises:
        ValueError: one line, if it holds no finished run, or its files do not fit each other.
    """
    for file in _NEEDED:
        if not (directory / file).is_file():
            raise ValueError(f"{shown(str(directory))}: is no finished run: it has no {file}")
    text = read_text(directory / "summary.json", FileKind.RECORD)
    try:
        summary = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{directory / 'summary.json'}: not JSON: {error.msg}") from None
    if not isinstance(summary, dict) or "outcome" not in summary:
        raise ValueError(f"{directory / 'summary.json'}: is no summary of a run")
    scenario = load_any_scenario(str(directory / "scenario.toml"))
    log = read_log(directory / "signals.parquet")
    return FinishedRun(
        name=name,
        directory=directory,
        summary=summary,
        result=KINDS[scenario.vehicle_kind].rebuilt(scenario, log, summary),
        pictures=pictures_of_page(directory / "report.html"),
    )


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
    if len({run.result.kind for run in runs}) > 1:
        raise ValueError("runs of trailers and of rovers can't be laid over each other")
    playbacks = [KINDS[run.result.kind].playback(run.result) for run in runs]
    most = max(playbacks, key=lambda playback: len(playback.charts))
    links = [*links, *[""] * (len(runs) - len(links))]
    played = [
        dataclasses.replace(playback.runs[0], name=run.name, pictures=run.pictures, link=link)
        for run, playback, link in zip(runs, playbacks, links, strict=True)
    ]
    played[1:] = [dataclasses.replace(run, lines=()) for run in played[1:]]  # the first one's ground
    return dataclasses.replace(
        playbacks[0],
        title=", ".join(run.name for run in runs),
        runs=tuple(played),
        charts=most.charts,
        readings=most.readings,
    )


def differences(runs: Sequence[FinishedRun]) -> Table:
    """Every number of the summaries, and how far the runs differ from the first one."""
    rows: list[Row] = []
    for group, listed in groups().items():
        lines = [_line(f"{group}.{name}", number, runs) for name, number in listed.numbers.items()]
        if known := [line for line in lines if line]:
            rows += [[listed.title], *known]
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
