"""The numbers of a summary as a report's page shows them: some on cards, all in a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Shown(NamedTuple):
    """A number of a summary, in people's words."""

    group: str
    name: str  # in the summary
    label: str
    unit: str
    factor: float  # from the summary's unit to ``unit``
    digits: int
    meaning: str

    def of(self, summary: Mapping[str, Any]) -> float | int | None:
        """Its value in the summary's unit; None if the summary has none."""
        numbers = summary.get(self.group)
        value = numbers.get(self.name) if isinstance(numbers, dict) else None
        return None if isinstance(value, dict) else value

    def text(self, value: float | int | None) -> str:
        """A value of it, without its unit."""
        return "–" if value is None else f"{self.factor * value:.{self.digits}f}"


def cards_html(summary: Mapping[str, Any], shown: Sequence[Shown]) -> str:
    """A card for each of these numbers that the summary has."""
    cards = [
        f'<div class="card"><b>{number.text(value)} <small>{number.unit}</small></b>'
        f"<span>{number.label}</span><p>{number.meaning}</p></div>"
        for number in shown
        if (value := number.of(summary)) is not None
    ]
    return '<div class="cards">\n' + "\n".join(cards) + "\n</div>"


def table_html(summary: Mapping[str, Any], shown: Sequence[Shown], titles: Mapping[str, str] | None = None) -> str:
    """A line for each of these numbers that the summary has, under the title of its group where there is one."""
    lines, group = [], ""
    for number in shown:
        value = number.of(summary)
        if value is None:
            continue
        if titles and number.group in titles and number.group != group:
            lines.append(f'<tr class="group"><th colspan="3">{titles[number.group]}</th></tr>')
        group = number.group
        lines.append(
            f'<tr><th>{number.label}</th><td class="value">{number.text(value)} {number.unit}</td>'
            f'<td class="meaning">{number.meaning}</td></tr>'
        )
    return '<div class="scroll"><table>' + "\n".join(lines) + "</table></div>"
