"""Numbers of a summary as a page shows them: the main ones on cards, all in a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from scenarios.report.page import Card, Column, Row, Table


class ShownNumber(NamedTuple):
    """A number of a summary with its label, unit and meaning."""

    group: str
    name: str  # in the summary
    label: str
    unit: str
    factor: float  # from the summary's unit to ``unit``
    digits: int
    meaning: str

    def of(self, summary: Mapping[str, Any]) -> float | None:
        """The value in the summary's unit; None if the summary has none."""
        numbers = summary.get(self.group)
        value = numbers.get(self.name) if isinstance(numbers, dict) else None
        return None if isinstance(value, dict) else value

    def text(self, value: float | None) -> str:
        """A value with its unit, or a dash."""
        return "–" if value is None else f"{self._digits(value)} {self.unit}".strip()

    def card(self, value: float) -> Card:
        """A value on a card."""
        return Card(self._digits(value), self.unit, self.label, self.meaning)

    def _digits(self, value: float) -> str:
        return f"{self.factor * value:z.{self.digits}f}"


def number_cards(summary: Mapping[str, Any], numbers: Sequence[ShownNumber], names: Sequence[str]) -> list[Card]:
    """A card for each number with one of these names that the summary has."""
    chosen = [number for number in numbers if number.name in names]
    return [number.card(value) for number in chosen if (value := number.of(summary)) is not None]


def number_table(
    summary: Mapping[str, Any], numbers: Sequence[ShownNumber], titles: Mapping[str, str] | None = None
) -> Table:
    """A row for each number that the summary has, below the title of its group if there is one."""
    rows: list[Row] = []
    group = ""
    for number in numbers:
        value = number.of(summary)
        if value is None:
            continue
        if titles and number.group in titles and number.group != group:
            rows.append([titles[number.group]])
        group = number.group
        rows.append([number.label, number.text(value), number.meaning])
    return Table((Column("name"), Column("number"), Column("note")), rows)
