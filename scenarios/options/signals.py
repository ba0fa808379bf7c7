"""The combination's own sensors as a scenario file describes them."""

from __future__ import annotations

from typing import Literal

from scenarios.options.base import Options, quantity

SteerGroups = Literal["vehicle", "single", "common_centre"]


class SignalOptions(Options):
    """What steering laws and no-slip estimates know of the combination: speed, angles, gyros, an accelerometer."""

    noise: float = quantity(
        1.0, "-", 0.0, 10.0, "Scale of the errors of speed, angle and motion sensors; 1: data sheets, 0: exact."
    )
