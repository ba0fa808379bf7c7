"""Parts that the pages of trailers' and rovers' runs have in common."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from scenarios.report.facts import changes, scenario_facts
from scenarios.report.numbers import number_cards
from scenarios.report.page import (
    Bar,
    Cell,
    Column,
    Page,
    Preformatted,
    Row,
    Section,
    Table,
    facts_table,
    outcome_verdict,
)
from scenarios.results.numbers import Summary
from scenarios.results.rover import RoverResult
from scenarios.results.run_result import RunResult
from scenarios.results.timing import Timing

_COLOURS = ("#1f5fa8", "#2a9d8f", "#e0761a", "#b8c0c8")


def run_html(
    result: RunResult | RoverResult,
    summary: Summary,
    on_cards: Sequence[str],
    sections: Iterable[Section],
) -> str:
    """The page of a run as HTML, with these numbers of the summary on cards."""
    scenario = _table(result.scenario_toml)
    facts = (scenario_facts(scenario), f"seed {result.seed}", f"{result.timing.simulated_s:.1f} s simulated")
    return Page(
        title=result.scenario,
        heading=result.scenario,
        subtitle=" · ".join(filter(None, facts)),
        changes=changes(scenario),
        verdict=outcome_verdict(result.outcome),
        cards=number_cards(summary, on_cards),
        sections=list(sections),
    ).html()


def _table(toml: str) -> Mapping[str, Any]:
    """The scenario as a table; empty if its text is none, which must not cost the report."""
    try:
        return tomllib.loads(toml)
    except tomllib.TOMLDecodeError:
        return {}


def timing_section(timing: Timing, stages: Sequence[str]) -> Section:
    """Computing time by stage; ``stages`` are the names of physics, rendering and estimation in this run."""
    seconds = (timing.physics_s, timing.render_s, timing.odometry_s, timing.rest_s)
    total = max(sum(seconds), 1e-9)
    rows: list[Row] = [
        [
            Cell(name, colour=colour),
            f"{t:.2f} s",
            f"{100 * t / total:.0f} %",
            f"{1e3 * t / max(timing.simulated_s, 1e-9):.0f} ms per simulated second",
        ]
        for name, colour, t in zip((*stages, "everything else"), _COLOURS, seconds, strict=True)
    ]
    parallel = timing.odometry_parallel_s
    text = (
        f"{timing.simulated_s:.1f} s of driving took {timing.wall_s:.1f} s of computing: "
        f"{timing.realtime_factor:.2f} times real time."
        + (f" {parallel:.1f} s of the {stages[-1]} ran in parallel to the other stages." if parallel > 0.05 else "")
    )
    bar = Bar([(colour, t / total) for colour, t in zip(_COLOURS, seconds, strict=True)])
    return Section("Computing time", text, [bar, Table((Column("name"), *[Column("number")] * 3), rows)])


def provenance_sections(scenario_toml: str, manifest: Mapping[str, object]) -> list[Section]:
    """The scenario as it was run, and versions and hashes; both collapsed."""
    facts = {key: _text(value) for key, value in manifest.items()}
    return [
        Section("Resolved scenario", content=[Preformatted(scenario_toml)], collapsed=True),
        Section("Versions and hashes", content=[facts_table(facts)], collapsed=True),
    ]


def _text(value: object) -> str:
    return ", ".join(f"{name} {version}" for name, version in value.items()) if isinstance(value, dict) else str(value)
