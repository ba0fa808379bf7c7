"""Table of a study's runs: one row for each, with its numbers and where it was made."""

from __future__ import annotations

from collections.abc import Sequence

import pyarrow as pa

from scenarios.studies.case import Outcome
from scenarios.studies.provenance import Made
from scenarios.studies.table import QUANTITIES


def runs_table(outcomes: Sequence[Outcome]) -> pa.Table:
    """Values on the axes, drawn values, seed, outcome, quantities with a number in any run, and provenance."""
    axes = [key for key, _ in outcomes[0].case.axes] if outcomes else []
    columns: dict[str, list[str | int | float | None]] = {
        key: [dict(outcome.case.axes)[key] for outcome in outcomes] for key in axes
    }
    for key in (key for key, _ in outcomes[0].case.drawn) if outcomes else ():
        columns[key] = [dict(outcome.case.drawn)[key] for outcome in outcomes]
    columns["seed"] = [outcome.case.seed for outcome in outcomes]
    columns["outcome"] = [str(outcome.numbers["outcome"]) for outcome in outcomes]
    for quantity in QUANTITIES:
        numbers = [outcome.number(quantity.path) for outcome in outcomes]
        if any(number is not None for number in numbers):
            columns[quantity.column] = list(numbers)
    for name in Made._fields:
        columns[name] = [None if outcome.made is None else getattr(outcome.made, name) for outcome in outcomes]
    return pa.table(columns)
