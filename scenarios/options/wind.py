"""Options of the wind."""

from __future__ import annotations

from scenarios.options.base import Options, quantity


class WindOptions(Options):
    """A gust along W's y on a stretch of W's x axis; none at a speed of 0. The vehicle file needs ``side_wind``."""

    speed: float = quantity(0.0, "m/s", -60.0, 60.0, "Speed of the gust, + towards W's +y, to the left at the start.")
    start: float = quantity(30.0, "m", -1e5, 1e5, "Where the gust begins, along W's x.")
    length: float = quantity(30.0, "m", 0.1, 1e5, "Length of the gust.")
    edge: float = quantity(5.0, "m", 0.1, 1e3, "Length over which it grows and falls.")
