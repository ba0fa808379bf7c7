"""How long a camera exposes: fixed, or regulated after the brightness of the images before."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

_TARGET: Final = 118.0  # mean level that is aimed at: 18 % reflectance at the usual gamma of 2.2 [grey levels]
_GAINS: Final = (0.25, 8.0)  # relative to the fixed exposure: what shutter and amplifier give


@dataclass(frozen=True, slots=True, kw_only=True)
class AutoExposure:
    """Exposure that follows the mean level of both images with a first-order lag, in stops."""

    time_constant: float  # [s]

    def settled(self, level: float) -> float:
        """The gain after a long look at images of a mean level [grey levels at a gain of 1]."""
        return min(max(_TARGET / max(level, 1e-3), _GAINS[0]), _GAINS[1])

    def step(self, gain: float, level: float, seconds: float) -> float:
        """The gain so many seconds after an image of that level was taken at the given gain."""
        share = 1.0 - math.exp(-seconds / self.time_constant)
        return gain * math.exp(share * math.log(self.settled(level) / gain))
