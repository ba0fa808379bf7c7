"""Numbers of a summary as a page shows them: the main ones on cards, all in a table."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple

from scenarios.report.page import Card, Column, Row, Table


class ShownNumber(NamedTuple):
    """A number with its label, unit and meaning."""

    label: str
    unit: str
    digits: int
    meaning: str
    factor: float = 1.0  # from the number's own unit to ``unit``

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
    tables = tomllib.loads((files("scenarios.report") / "numbers.toml").read_text(encoding="utf-8"))
    return {
        name: Group(table.pop("title"), {key: ShownNumber(**fields) for key, fields in table.items()})
        for name, table in tables.items()
    }


def number_cards(summary: Mapping[str, Any], paths: Sequence[str]) -> list[Card]:
    """A card for each number ``group.name`` that the summary has."""
    cards = []
    for group, _, name in (path.partition(".") for path in paths):
        number, value = groups()[group].numbers[name], _value(summary, group, name)
        if value is not None:
            cards.append(Card(number.digits_of(value), number.unit, number.label, number.meaning))
    return cards


def number_table(summary: Mapping[str, Any]) -> Table:
    """A row for each number that the summary has, below the title of its group."""
    rows: list[Row] = []
    for name, group in groups().items():
        values = {key: _value(summary, name, key) for key in group.numbers}
        shown = [key for key, value in values.items() if value is not None]
        rows += [[group.title]] if shown else []
        rows += [[(n := group.numbers[key]).label, n.text(values[key]), n.meaning] for key in shown]
    return Table((Column("name"), Column("number"), Column("note")), rows)


def _value(summary: Mapping[str, Any], group: str, name: str) -> float | None:
    numbers = summary.get(group)
    return numbers.get(name) if isinstance(numbers, Mapping) else None
