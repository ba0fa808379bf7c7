"""Sections that pages of runs share: facts, numbers of the summary, timing and provenance."""

import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from offtrack.reports.page import (
    Bar,
    Card,
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
from scenarios.options.scenario import load_any_scenario
from scenarios.options.shipped import scenario_names
from scenarios.options.tables import FaultOptions
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_summary import Summary, Timing, number_at
from scenarios.results.trailer_result import RunResult
from vehicle.foundation.user_file import shown

_OWN_UNITS: Final = {"mm": "m", "%": "-", "°": "rad", "km/h": "m/s", "": "-"}  # by the unit shown


class ShownNumber(NamedTuple):
    """A number with its label, unit and meaning."""

    label: str
    unit: str
    digits: int
    meaning: str
    factor: float = 1.0  # from the number's own unit to ``unit``
    column: str = ""  # short label in tables of studies; empty: not a column there
    over_runs: Literal["rms", "max"] = "max"  # what such a column shows of several runs

    @property
    def own_unit(self) -> str:
        """Unit of the number in ``summary.json``; "-" for none."""
        return self.unit if self.factor == 1.0 and self.unit else _OWN_UNITS[self.unit]

    @property
    def own_digits(self) -> int:
        """Digits behind the decimal point in the number's own unit."""
        return self.digits + round(math.log10(self.factor))

    def text(self, value: float | None) -> str:
        """A value with its unit; a dash if there is none."""
        if value is None or not math.isfinite(value):
            return "–"
        return self.digits_of(value) + (self.unit if self.unit in ("", "°") else f" {self.unit}")

    def digits_of(self, value: float) -> str:
        """A value without its unit."""
        return f"{self.factor * value:z.{self.digits}f}"


class Group(NamedTuple):
    """A group of numbers: its title, and the numbers by their names."""

    title: str
    numbers: Mapping[str, ShownNumber]


@lru_cache(maxsize=1)
def groups() -> Mapping[str, Group]:
    """All groups by their names, from ``numbers.toml``."""
    tables = tomllib.loads((files("offtrack.reports") / "numbers.toml").read_text(encoding="utf-8"))
    return {
        name: Group(table.pop("title"), {key: ShownNumber(**fields) for key, fields in table.items()})
        for name, table in tables.items()
    }


def number_cards(summary: Mapping[str, Any], paths: Sequence[str]) -> list[Card]:
    """A card for each number ``group.name`` that the summary has."""
    cards = []
    for path in paths:
        group, _, name = path.partition(".")
        number, value = groups()[group].numbers[name], number_at(summary, path)
        if value is not None:
            cards.append(Card(number.digits_of(value), number.unit, number.label, number.meaning))
    return cards


def number_table(summary: Mapping[str, Any]) -> Table:
    """A row for each number that the summary has, below the title of its group."""
    rows: list[Row] = []
    for name, group in groups().items():
        values = {key: number_at(summary, f"{name}.{key}") for key in group.numbers}
        shown = [key for key, value in values.items() if value is not None]
        rows += [[group.title]] if shown else []
        rows += [[(n := group.numbers[key]).label, n.text(values[key]), n.meaning] for key in shown]
    return Table((Column("name"), Column("number"), Column("note")), rows)


_MOST: Final = 10  # changed keys that are listed
_LONGEST: Final = 60  # characters of a value


def scenario_facts(scenario: Mapping[str, Any]) -> str:
    """Vehicle, law and estimator of a resolved scenario, as a table."""
    if scenario.get("kind") == "rover":
        named = {"": "rover", "slip estimator ": "slip_estimator", "slip compensation ": "slip_compensation"}
    else:
        named = {"": "vehicle", "trailer steering ": "trailer_steering", "off-tracking ": "off_tracking"}
    facts = [f"{word}{_name(str(scenario[key]))}" for word, key in named.items() if key in scenario]
    if scenario.get("off_tracking") == "viso_ot":
        facts[-1] += f" ({scenario.get('odometry', 'keyframe')})"
    if fmu := scenario.get("plant", {}).get("fmu"):
        facts.append(f"plant {_name(fmu)}")
    return " · ".join(facts)


def changes(scenario: Mapping[str, Any]) -> str:
    """Keys of a resolved scenario that differ from the shipped one of its name, in one line; empty without any."""
    if scenario.get("name") not in scenario_names():
        return ""
    shipped_one = load_any_scenario(str(scenario["name"])).model_dump(mode="json", exclude_none=True)
    now, shipped = dict(_values(scenario)), dict(_values(shipped_one))
    keys = [key for key in {**now, **shipped} if now.get(key) != shipped.get(key)]
    listed = [f"{key} = {_value_text(now[key])}" if key in now else f"{key} not given" for key in keys[:_MOST]]
    more = f" and {len(keys) - _MOST} more" if len(keys) > _MOST else ""
    return f"Changed: {', '.join(listed)}{more}" if keys else ""


def _values(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _values(value, f"{before}{key}.")
        else:
            plain = list(value) if isinstance(value, tuple) else value
            yield f"{before}{key}", _faults(value) if key == "faults" else plain


def _faults(tables: Iterable[Mapping[str, Any]]) -> str:
    """Faults as ``--set`` takes them; a user's own kind need not be at hand any more."""
    return "; ".join(str(FaultOptions.model_construct(None, **table)) for table in tables) or "none"


def _value_text(value: Any) -> str:
    return shown(_name(value) if isinstance(value, str) else str(value), _LONGEST)


def _name(text: str) -> str:
    """The text; of a file its name without the folders."""
    return Path(text).name if "/" in text else text


ERROR_TEXT: Final = (
    "About 95 % of the errors lie inside the band if the estimator states its standard deviation correctly."
)
FEATURES_TEXT: Final = "Features matched in all images of a frame, and the inliers: matches that agree on one motion."
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
