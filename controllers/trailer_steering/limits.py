"""Checks and limits that steering laws share."""

from __future__ import annotations

import numpy as np

from controllers.trailer import TrailerGeometry
from vehicle.frames import FloatArray


def check_steered(law: str, trailer: TrailerGeometry) -> None:
    """Refuse a trailer without steered axles.

    Raises:
        ValueError: if none of its axles is steered.
    """
    if not trailer.steered_distances:
        raise ValueError(f"{law}: the trailer has no steered axle")


def reachable(trailer: TrailerGeometry, last: FloatArray, wanted: FloatArray, elapsed: float) -> FloatArray:
    """The wanted angles (n_steered,) [rad], limited to those within reach of the last ones in ``elapsed`` [s]."""
    ratios = np.abs(trailer.steer_ratios)  # the limits are those of the actuators
    reach, limit = trailer.max_steer_rate * elapsed * ratios, trailer.max_steer * ratios
    return np.clip(np.clip(wanted, last - reach, last + reach), -limit, limit)
