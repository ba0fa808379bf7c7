"""The law without steering: axles stay straight."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from controllers.trailer import SteerCommand, SteeringLaw, TrailerGeometry
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals


class Unsteered(SteeringLaw[None]):
    """Zero demand on every steered axle."""

    uses_off_tracking: ClassVar[bool] = False

    def __init__(self, trailer: TrailerGeometry) -> None:
        self._axles = len(trailer.steered_distances)

    def init(self) -> None:
        """No memory."""
        return

    def step(
        self, memory: None, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[None, SteerCommand]:
        """Straight wheels."""
        return None, SteerCommand(angles=np.zeros(self._axles))
