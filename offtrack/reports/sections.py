"""Sections that pages of runs share: facts, numbers of the summary, timing and provenance."""

import math
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from offtrack.reports.page import (
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
from scenarios.results.run_summary import Timing, number_at
from vehicle.foundation.user_file import dotted, shown

_OWN_UNITS: Final = {"mm": "m", "%": "-", "°": "rad", "km/h": "m/s", "": "-"}  # by the unit shown


class ShownNumber(NamedTuple):
    """A number with its label, unit and meaning."""

    label: str
    unit: str
    digits: int
    meaning: str
    factor: float = 1.0  # from the number's own unit to ``unit``
    column: str = ""  # short label in tables of studies; empty: not a column there
    over_runs: Literal["rms", "max", "min"] = "max"  # what such a column shows of several runs
    better: Literal["", "less", "more"] = ""  # which value of two runs is better; empty: neither

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

    def said(self, value: float) -> str:
        """A value with its unit inside a sentence; lengths in the unit that suits them."""
        return length(value) if self.own_unit == "m" else self.text(value)

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


_CARDS: Final = 4  # on a page


def shown_number(path: str) -> ShownNumber:
    """The number ``group.name``."""
    group, _, name = path.partition(".")
    return groups()[group].numbers[name]


def number_cards(summary: Mapping[str, Any], paths: Sequence[str]) -> list[Card]:
    """A card for each of the first four numbers ``group.name`` that the summary has, with time and place or meaning."""
    known = [(path, value) for path in paths if (value := number_at(summary, path)) is not None][:_CARDS]
    numbers = [(shown_number(path), path, value) for path, value in known]
    return [
        Card(number.digits_of(value), number.unit, number.label, where(summary, path) or number.meaning)
        for number, path, value in numbers
    ]


def where(summary: Mapping[str, Any], path: str) -> str:
    """Time and place of a number, in words; empty if the summary does not tell them."""
    stem = path.removesuffix("_m")
    time, x, y = (number_at(summary, f"{stem}_{ending}") for ending in ("time_s", "x_m", "y_m"))
    place = "" if x is None or y is None else f", at x {x:.1f} m, y {y:.1f} m"
    return "" if time is None else f"after {time:.1f} s{place}"


def number_table(summary: Mapping[str, Any]) -> Table:
    """A row for each number that the summary has, below the title of its group."""
    rows: list[Row] = []
    for name, group in groups().items():
        values = {key: number_at(summary, f"{name}.{key}") for key in group.numbers}
        shown = [key for key, value in values.items() if value is not None]
        rows += [[group.title]] if shown else []
        for key in shown:
            number, at = group.numbers[key], where(summary, f"{name}.{key}")
            rows.append([number.label, number.text(values[key]), number.meaning + (f" Here {at}." if at else "")])
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


def changes(scenario: Mapping[str, Any], besides: Collection[str] = ()) -> str:
    """Keys of a resolved scenario that differ from the shipped one of its name, in one line; empty without any.

    What only follows from another kind of a table, such as the defaults of another course, is left out, and so are the
    keys ``besides``.
    """
    if scenario.get("name") not in scenario_names():
        return ""
    name, now = str(scenario["name"]), _values(scenario)
    shipped = _resolved(name)
    chosen = [key for key in now if key.endswith((".kind", ".file")) and now[key] != shipped.get(key)]
    try:
        implied = _resolved(name, [f"{key}={now[key]}" for key in chosen])
    except ValueError:  # another kind needs more keys, or its file is gone by now
        implied = shipped
    keys = [key for key in {**now, **implied} if key in chosen or now.get(key) != implied.get(key)]
    keys = [key for key in keys if key not in besides]
    listed = [f"{key} = {_value_text(now[key])}" if key in now else f"{key} not given" for key in keys[:_MOST]]
    more = f" and {len(keys) - _MOST} more" if len(keys) > _MOST else ""
    return f"Changed: {', '.join(listed)}{more}" if keys else ""


def _resolved(name: str, settings: Sequence[str] = ()) -> dict[str, Any]:
    """Values of a shipped scenario with these settings by their dotted keys."""
    return _values(load_any_scenario(name, settings).model_dump(mode="json", exclude_none=True))


def _values(table: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a resolved scenario by their dotted keys; faults as ``--set`` takes them."""
    values = {key: list(value) if isinstance(value, tuple) else value for key, value in dotted(table)}
    return values | ({"faults": _faults(values["faults"])} if "faults" in values else {})


def _faults(tables: Iterable[Mapping[str, Any]]) -> str:
    """Faults as ``--set`` takes them; a user's own kind need not be at hand any more."""
    return "; ".join(str(FaultOptions.model_construct(None, **table)) for table in tables) or "none"


def _value_text(value: Any) -> str:
    return shown(_name(value) if isinstance(value, str) else str(value), _LONGEST)


def _name(text: str) -> str:
    """The text; of a file its name without the folders."""
    return Path(text).name if "/" in text else text


def run_page(
    scenario: Mapping[str, Any], seed: int, summary: Mapping[str, Any], sections: Iterable[Section], title: str = ""
) -> Page:
    """The page of a run, or of a run of a study with this title: its verdict, its main numbers, and these sections."""
    simulated = number_at(summary, "timing.simulated_s")
    facts = (scenario_facts(scenario), f"seed {seed}", f"{simulated:.1f} s simulated" if simulated else "")
    name = course_title(scenario) or str(summary["scenario"])
    return Page(
        title=title or name,
        subtitle=" · ".join(filter(None, (title and name, *facts))),
        changes=changes(scenario),
        verdict=outcome_verdict(str(summary["outcome"])),
        cards=number_cards(summary, _main_numbers(scenario, summary)),
        sections=list(sections),
    )


def course_title(scenario: Mapping[str, Any]) -> str:
    """Name of a scenario, behind the course if that is not the one of the shipped scenario of this name."""
    name, course = str(scenario.get("name", "")), dict(scenario.get("course", {}))
    if name not in scenario_names() or "kind" not in course:
        return name
    shipped, file = _resolved(name), str(course.get("file", ""))
    if course["kind"] == shipped.get("course.kind") and Path(file).name == Path(shipped.get("course.file", "")).name:
        return name
    return f"{Path(file).stem or _name(course['kind'])} (scenario {name})"


def length(metres: float) -> str:
    """A length in words: in millimetres, centimetres or metres."""
    if abs(metres) < 0.01:
        return f"{1e3 * metres:.1f} mm"
    return f"{1e2 * metres:.1f} cm" if abs(metres) < 1.0 else f"{metres:.2f} m"


def nearest_edge(summary: Mapping[str, Any]) -> str:
    """Path of the least clearance: to the lane if there is one, else to the road; empty without any."""
    for kind in ("lane", "wheel"):
        paths = [f"road.{kind}_clearance_{side}_m" for side in ("left", "right")]
        known = [(value, path) for path in paths if (value := number_at(summary, path)) is not None]
        if known:
            return min(known)[1]
    return ""


def _main_numbers(scenario: Mapping[str, Any], summary: Mapping[str, Any]) -> list[str]:
    """Numbers that a user asks for first, the most important first; errors of exact truth are none."""
    exact = "truth" in (scenario.get("off_tracking"), scenario.get("slip_estimator"))
    errors = [] if exact else ["off_tracking.estimate_error_rms_m", "slip.error_rms_deg"]
    return [
        *("off_tracking.true_max_m", "slip.cross_track_max_m", nearest_edge(summary) or "swept_path.tail_swing_m"),
        *("swept_path.max_width_m", *errors, "position.corrected_error_m", "wheels.slip_ratio_mean"),
        *("wheels.sinkage_max_m", "steer.max_deg", "tyres.friction_used_max"),
    ]


def table_of(toml: str) -> Mapping[str, Any]:
    """The scenario as a table; empty if its text is none, which must not cost the report."""
    try:
        return tomllib.loads(toml)
    except tomllib.TOMLDecodeError:
        return {}


def timing_section(timing: Timing, stages: Sequence[str]) -> Section:
    """Computing time by stage; ``stages`` are the names of physics, rendering and estimation in this run."""
    seconds = (timing.physics_s, timing.render_s, timing.odometry_s, timing.rest_s)
    total, simulated = max(sum(seconds), 1e-9), max(timing.simulated_s, 1e-9)
    rows: list[Row] = [
        [name, f"{t:.2f} s", Cell(f"{100 * t / total:.0f} % ", share=t / total), f"{1e3 * t / simulated:.0f} ms"]
        for name, t in zip((*stages, "everything else"), seconds, strict=True)
    ]
    parallel = timing.odometry_parallel_s
    text = (
        f"{timing.simulated_s:.1f} s of driving took {timing.wall_s:.1f} s of computing: "
        f"{timing.realtime_factor:.2f} times real time."
        + (f" {parallel:.1f} s of the {stages[-1]} ran in parallel to the other stages." if parallel > 0.05 else "")
    )
    columns = [Column("name", "stage"), *(Column("number", one) for one in ("time", "share", "a simulated second"))]
    return Section("Computing time", text, [Table(columns, rows)])


def provenance_sections(scenario_toml: str, manifest: Mapping[str, object]) -> list[Section]:
    """The scenario as it was run, and versions and hashes; both collapsed."""
    facts = {key: _text(value) for key, value in manifest.items()}
    return [
        Section("Resolved scenario", content=[Preformatted(scenario_toml)], collapsed=True),
        Section("Versions and hashes", content=[facts_table(facts)], collapsed=True),
    ]


def _text(value: object) -> str:
    return ", ".join(f"{name} {version}" for name, version in value.items()) if isinstance(value, dict) else str(value)
