"""Exposure control of a camera from the brightness of its previous images."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

_TARGET: Final = 118.0  # mean level of the control: 18 % reflectance at the usual gamma of 2.2 [grey levels]
_GAINS: Final = (0.25, 8.0)  # limits of shutter and amplifier, relative to the fixed exposure


@dataclass(frozen=True, slots=True, kw_only=True)
class AutoExposure:
    """Exposure that follows the mean level of both images with a first-order lag, in stops."""

    time_constant: float  # [s]

    def settled(self, level: float) -> float:
        """Steady-state gain for images of a mean level [grey levels at a gain of 1]."""
        return min(max(_TARGET / max(level, 1e-3), _GAINS[0]), _GAINS[1])

    def step(self, gain: float, level: float, seconds: float) -> float:
        """Gain a number of seconds after an image of this level was taken at the given gain."""
        share = 1.0 - math.exp(-seconds / self.time_constant)
        return gain * math.exp(share * math.log(self.settled(level) / gain))
