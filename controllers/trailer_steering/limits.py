"""What steering laws have in common: parameters within limits, demands that the actuators can follow."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from controllers.trailer import TrailerGeometry
from vehicle.frames import FloatArray


def check_limits(values: Mapping[str, float], limits: Mapping[str, tuple[float, float, str]]) -> None:
    """Refuses values outside their limits: lowest, highest, unit.

    Raises:
        ValueError: naming the first such value, its limits and their unit.
    """
    for name, value in values.items():
        low, high, unit = limits[name]
        if not isinstance(value, int | float) or not low <= value <= high:  # a scenario may hold a word here
            raise ValueError(f"{name} = {value} {unit} must be between {low:g} and {high:g} {unit}")


def check_steered(law: str, trailer: TrailerGeometry) -> None:
    """Refuses a trailer that has nothing to steer.

    Raises:
        ValueError: if none of its axles is steered.
    """
    if not trailer.steered_distances:
        raise ValueError(f"{law}: the trailer has no steered axle")


def reachable(trailer: TrailerGeometry, last: FloatArray, wanted: FloatArray, elapsed: float) -> FloatArray:
    """The wanted angles (n_steered,) as far as the actuators get from the last ones in ``elapsed`` [s], [rad]."""
    ratios = np.abs(trailer.steer_ratios)  # rate and angle are limited at the actuators
    reach, limit = trailer.max_steer_rate * elapsed * ratios, trailer.max_steer * ratios
    return np.clip(np.clip(wanted, last - reach, last + reach), -limit, limit)
