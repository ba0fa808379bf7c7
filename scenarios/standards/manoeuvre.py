"""What every standard manoeuvre hands back: its outcome, what was measured in it, and the log it was measured from."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from scenarios.results.log import Log
from vehicle.frames import FloatArray

Figures = Mapping[str, float]  # name of a quantity to its value in SI units; NaN where it could not be measured


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Manoeuvre:
    """One standard manoeuvre, driven and measured."""

    key: str  # "turn", "roundabout", …
    title: str
    how: str  # it was driven, for people
    outcome: str  # "completed" or what befell the combination
    figures: Figures
    log: Log
    course: FloatArray | None = None  # (n, 2) path of the guided point, where there is one [m]


def measured(names: tuple[str, ...], outcome: str, figures: Callable[[], Figures]) -> Figures:
    """What ``figures`` tells under these names; NaN throughout if the manoeuvre was not completed."""
    there = figures() if outcome == "completed" else {}
    return {name: float(there.get(name, math.nan)) for name in names}
