"""The table of a study: one row for each combination of its axes' values, over all seeds."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from scenarios.studies.case import Outcome, Settings

Reduction = Literal["rms", "max"]


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number of the summary as a column of a study's table."""

    path: str  # in the summary
    label: str  # short, for narrow columns
    unit: str
    digits: int
    over_seeds: Reduction
    meaning: str

    @property
    def column(self) -> str:
        """Column name in CSV and Parquet tables."""
        return self.path.rpartition(".")[2]


QUANTITIES: Final = (
    Quantity("off_tracking.true_rms_m", "error RMS", "m", 3, "rms",
             "distance of the follow point from the hitch's path, RMS"),
    Quantity("off_tracking.true_max_m", "error max", "m", 3, "max",
             "distance of the follow point from the hitch's path, maximum"),
    Quantity("off_tracking.estimate_error_rms_m", "estimate RMS", "m", 3, "rms",
             "error of the estimated off-tracking, RMS"),
    Quantity("swept_path.max_width_m", "width", "m", 2, "max",
             "swept width"),
    Quantity("swept_path.tail_swing_entry_m", "swing in", "m", 2, "max",
             "tail swing at the entry of the turn"),
    Quantity("swept_path.tail_swing_exit_m", "swing out", "m", 2, "max",
             "tail swing at the exit of the turn"),
    Quantity("steer.max_deg", "steer", "°", 1, "max",
             "largest steer angle of a trailer axle"),
    Quantity("steer.max_rate_deg_s", "rate", "°/s", 1, "max",
             "largest steer rate of a trailer axle"),
    Quantity("tyres.friction_used_max", "friction", "-", 2, "max",
             "largest share of the friction that a tyre used"),
    Quantity("slip.cross_track_rms_m", "cross RMS", "m", 3, "rms",
             "cross-track error of the rover, RMS"),
    Quantity("slip.error_rms_deg", "slip RMS", "°", 2, "rms",
             "error of the estimated slip angle, RMS"),
)  # fmt: skip


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
    points: dict[Settings, list[Outcome]] = {}
    for outcome in outcomes:
        points.setdefault(outcome.case.axes, []).append(outcome)
    return [_row(axes, group) for axes, group in points.items()]


def shown_quantities(rows: Sequence[Row]) -> tuple[Quantity, ...]:
    """Quantities with a number in at least one row."""
    return tuple(q for q in QUANTITIES if any(row.numbers[q.path] is not None for row in rows))


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
    return math.sqrt(float(np.mean(known**2))) if over_seeds == "rms" else float(known.max())
