"""Gradual correction of the off-tracking after a bridge, so that no step reaches the steering."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.estimates import Health, OffTracking
from vehicle.clock import TICK

# A correction of 0.1 m over this time moves the axles at 4 deg/s with a law of 0.77 rad/m. Longer would keep a known
# error, shorter would be felt [s].
_DURATION = 1.0
# A shorter bridge, such as that of a late frame, ends in a correction of some millimetres: it is made at once [ticks].
_SHORTEST = 400


class Correction(NamedTuple):
    """A correction that is being made."""

    tick: int  # at which it began
    offset: float  # value before it minus value after it [m]


def corrected(
    before: Correction | None, bridged: OffTracking, measured: OffTracking, since: int, follow_distance: float
) -> Correction | None:
    """Correction at the end of a bridge that began at the tick ``since``, from its estimate to the measured one."""
    if Health.LOST in (bridged.health, measured.health) or measured.tick - since < _SHORTEST:
        return before
    shown = blended(bridged, before, follow_distance)
    return Correction(measured.tick, shown.value - measured.value)


def blended(estimate: OffTracking, correction: Correction | None, follow_distance: float) -> OffTracking:
    """The estimate with the part of the correction that is still to be made.

    The path is sheared, so that it stays where it is at the hitch and agrees with the value at the follow point. What
    is held back is an error, and adds to the standard deviation.
    """
    if correction is None or estimate.health is Health.LOST:
        return estimate
    left = 1.0 - (estimate.tick - correction.tick) * TICK / _DURATION
    if not 0.0 < left <= 1.0:
        return estimate
    offset = left * correction.offset
    x, y = estimate.path.T
    return replace(
        estimate,
        value=estimate.value + offset,
        std=math.hypot(estimate.std, offset),
        path=np.column_stack([x, y - x * offset / follow_distance]),
        path_tangent=math.atan(math.tan(estimate.path_tangent) - offset / follow_distance),
    )
