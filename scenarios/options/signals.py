"""Options of the combination's own sensors."""

from __future__ import annotations

from typing import Literal

from scenarios.options.base import Options, quantity

SteerGroups = Literal["vehicle", "single", "common_centre"]


class SignalOptions(Options):
    """Speed sensor, angle sensors, gyros and accelerometer, for steering laws and no-slip estimators."""

    noise: float = quantity(
        1.0, "-", 0.0, 10.0, "Scale of the errors of speed, angle and motion sensors; 1: data sheets, 0: exact."
    )
