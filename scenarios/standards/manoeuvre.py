"""Result of a standard manoeuvre: outcome, measured quantities, and log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from scenarios.results.log import Log
from scenarios.standards.conditions import STANDARD, Conditions
from vehicle.frames import FloatArray

Figures = Mapping[str, float]  # value of each quantity by name, in SI units; NaN if it could not be measured


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Manoeuvre:
    """Result of one standard manoeuvre."""

    key: str  # "turn", "roundabout", …
    title: str
    how: str  # description of the test
    outcome: str  # "completed" or the mishap
    figures: Figures
    log: Log
    conditions: Conditions = STANDARD
    course: FloatArray | None = None  # (n, 2) path of the guided point, if there is one [m]


def measured(names: tuple[str, ...], outcome: str, figures: Callable[[], Figures]) -> Figures:
    """Figures of these names; all NaN if the manoeuvre was not completed."""
    values = figures() if outcome == "completed" else {}
    return {name: float(values.get(name, math.nan)) for name in names}
