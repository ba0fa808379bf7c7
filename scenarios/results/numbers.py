"""Numbers of a summary, ready for JSON."""

from __future__ import annotations

import math

from scenarios.results.timing import Timing

Numbers = dict[str, float | int | None]
Summary = dict[str, str | int | Numbers | dict[str, Numbers]]


def number(value: float) -> float | None:
    """The value to the last micrometre, or None where there is no number."""
    return round(float(value), 6) if math.isfinite(value) else None


def timing_numbers(timing: Timing) -> Numbers:
    """The group ``timing`` of a summary."""
    names = ("simulated_s", "wall_s", "realtime_factor", "physics_s", "render_s", "odometry_s")
    return {name: number(getattr(timing, name)) for name in names}
