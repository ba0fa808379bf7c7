"""Checks and limits that steering laws share."""

from __future__ import annotations

import numpy as np

from controllers.trailer import TrailerGeometry
from vehicle.frames import FloatArray


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
