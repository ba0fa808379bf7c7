"""Table of a study: a row for each point, and the spread of a quantity over the runs of a point."""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.special import betaincinv, stdtrit

from offtrack.reports.sections import groups, length
from offtrack.studies.case import Outcome, Settings
from vehicle.frames import FloatArray

Reduction = Literal["rms", "max", "min"]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number of the summary as a column of a study's table."""

    path: str  # in the summary
    label: str  # short, for narrow columns
    unit: str
    digits: int
    over_seeds: Reduction
    meaning: str  # its full label
    better: Literal["", "less", "more"] = ""  # which value of two is better; empty: neither

    @property
    def spoken(self) -> str:
        """Its full label inside a sentence, as "maximum true off-tracking"."""
        head, _, tail = self.meaning.partition(", ")
        return f"{tail} {head[:1].lower()}{head[1:]}".strip()

    def said(self, value: float) -> str:
        """A value with its unit inside a sentence."""
        return length(value) if self.unit == "m" else f"{value:.{self.digits}f} {self.unit}".removesuffix(" -")

    @property
    def column(self) -> str:
        """Column name in CSV and Parquet tables."""
        return self.path.rpartition(".")[2]


QUANTITIES: Final = tuple(
    Quantity(
        path=f"{group}.{name}",
        label=number.column,
        unit=number.own_unit,
        digits=number.own_digits,
        over_seeds=number.over_runs,
        meaning=number.label,
        better=number.better,
    )
    for group, numbers in groups().items()
    for name, number in numbers.numbers.items()
    if number.column
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One point of the grid, over all seeds."""

    axes: Settings
    runs: int
    completed: int
    endings: tuple[str, ...]  # outcomes of the other runs, without repetition
    numbers: Mapping[str, float | None]  # by the quantity's path


def rows_of(outcomes: Sequence[Outcome]) -> list[Row]:
    """A row for every point, in the order of the outcomes."""
    return [_row(axes, group) for axes, group in by_axes(outcomes).items()]


def by_axes(outcomes: Sequence[Outcome]) -> dict[Settings, list[Outcome]]:
    """The runs of each point, in their order."""
    points: dict[Settings, list[Outcome]] = {}
    for outcome in outcomes:
        points.setdefault(outcome.case.axes, []).append(outcome)
    return points


def shown_quantities(rows: Sequence[Row]) -> tuple[Quantity, ...]:
    """Quantities with a number in at least one row."""
    return tuple(q for q in QUANTITIES if any(row.numbers[q.path] is not None for row in rows))


def main_quantity(rows: Sequence[Row]) -> Quantity | None:
    """The quantity that tells which run is better: the largest off-tracking, else the first with a better side."""
    shown = [q for q in shown_quantities(rows) if q.better]
    return next((q for q in shown if q.path == "off_tracking.true_max_m"), shown[0] if shown else None)


def best_rows(rows: Sequence[Row], quantity: Quantity) -> list[Row]:
    """Rows with the best value that completed all runs; none if all show the same, or no side is better."""
    known = [(value, row) for row in rows if (value := row.numbers[quantity.path]) is not None]
    complete = [value for value, row in known if row.completed == row.runs]
    if not quantity.better or len({text_of(quantity, value) for value in complete}) < 2:
        return []
    best = text_of(quantity, (min if quantity.better == "less" else max)(complete))
    return [row for value, row in known if row.completed == row.runs and text_of(quantity, value) == best]


def text_of(quantity: Quantity, value: float | None) -> str:
    """The number as text for tables."""
    return "-" if value is None else f"{value:.{quantity.digits}f}"


def table_csv(rows: Sequence[Row]) -> str:
    """The rows as CSV in SI units, other units in the column name."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    quantities = shown_quantities(rows)
    axes = [key for key, _ in rows[0].axes] if rows else []
    writer.writerow([*axes, "runs", "completed", "endings", *(q.column for q in quantities)])
    for row in rows:
        numbers = ["" if row.numbers[q.path] is None else row.numbers[q.path] for q in quantities]
        writer.writerow([*(value for _, value in row.axes), row.runs, row.completed, "; ".join(row.endings), *numbers])
    return text.getvalue()


def _row(axes: Settings, outcomes: Sequence[Outcome]) -> Row:
    return Row(
        axes=axes,
        runs=len(outcomes),
        completed=sum(outcome.completed for outcome in outcomes),
        endings=tuple(dict.fromkeys(str(o.numbers["outcome"]) for o in outcomes if not o.completed)),
        numbers={q.path: _reduced(q.over_seeds, (o.number(q.path) for o in outcomes)) for q in QUANTITIES},
    )


def _reduced(over_seeds: Reduction, values: Iterable[float | None]) -> float | None:
    known = np.array([value for value in values if value is not None])
    if not known.size:
        return None
    return math.sqrt(float(np.mean(known**2))) if over_seeds == "rms" else float(getattr(known, over_seeds)())


CONFIDENCE: Final = 0.95


class Spread(NamedTuple):
    """Values of a quantity over the runs of a point."""

    axes: Settings
    values: FloatArray  # (n,) in the order of the draws, NaN for runs without a number

    @property
    def known(self) -> FloatArray:
        """The values that are numbers."""
        return self.values[np.isfinite(self.values)]


class Exceeding(NamedTuple):
    """How often a limit was exceeded, or a run did not end by completing its course."""

    beyond: int
    runs: int

    @property
    def share(self) -> float:
        """Share of the runs."""
        return self.beyond / self.runs

    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval of the probability."""
        tail, k, n = 0.5 * (1.0 - CONFIDENCE), self.beyond, self.runs
        low = 0.0 if k == 0 else float(betaincinv(k, n - k + 1, tail))
        high = 1.0 if k == n else float(betaincinv(k + 1, n - k, 1.0 - tail))
        return low, high


def spreads(outcomes: Sequence[Outcome], quantity: Quantity) -> list[Spread]:
    """The values of each point of the grid, in the order of the outcomes."""
    return [
        Spread(axes, np.array([run.number(quantity.path) for run in runs], dtype=np.float64))
        for axes, runs in by_axes(outcomes).items()
    ]


def exceeding(outcomes: Sequence[Outcome], axes: Settings, path: str, limit: float) -> Exceeding:
    """Runs of a point that exceeded a limit, were not completed, or have no number."""
    runs = [outcome for outcome in outcomes if outcome.case.axes == axes]
    numbers = [(outcome.completed, outcome.number(path)) for outcome in runs]
    return Exceeding(sum(not done or number is None or number > limit for done, number in numbers), len(runs))


def running_mean(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of the first 1, 2, ... n values, and the half width of its confidence interval (Student), (n,) each.

    The half width of one value is infinite. It holds for independent draws; for Latin hypercubes and Sobol sequences
    it is too wide.
    """
    count = np.arange(1, len(values) + 1)
    mean = np.cumsum(values) / count
    squares = np.cumsum(values**2) - count * mean**2
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.sqrt(np.maximum(squares, 0.0) / (count - 1))
        half = stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE) * deviation / np.sqrt(count)
    return mean, np.where(count > 1, half, np.inf)
