"""Numbers of a summary, ready for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from scenarios.results.timing import Timing

Numbers = dict[str, float | int | None]
Summary = dict[str, str | int | list[str] | Numbers | dict[str, Numbers]]


def number(value: float) -> float | None:
    """The value rounded to six decimals; None if it is not finite."""
    return round(float(value), 6) if math.isfinite(value) else None


def number_at(summary: Mapping[str, Any], path: str) -> float | None:
    """The number ``group.name`` of a summary; None if there is none."""
    value: Any = summary
    for part in path.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return None if value is None else float(value)


def timing_numbers(timing: Timing) -> Numbers:
    """The group ``timing`` of a summary."""
    names = ("simulated_s", "wall_s", "realtime_factor", "physics_s", "render_s", "odometry_s")
    return {name: number(getattr(timing, name)) for name in names}
