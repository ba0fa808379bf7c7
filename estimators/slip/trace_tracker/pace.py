"""Models of how fast slip changes, for two filters that run in parallel."""

from __future__ import annotations

import math
from typing import Final, NamedTuple


class Pace(NamedTuple):
    """Random walk of slip, plus a trend with a correlation length."""

    walk: float  # per sqrt(m) [rad]
    trend: float  # standard deviation [rad/m]
    length: float  # correlation length of the trend [m]


# Slip that varies by 1.6 deg within 5 s at 8 cm/s has a random walk of 3.6 deg/sqrt(m).
QUICK: Final = Pace(walk=math.radians(4.0), trend=0.0, length=1.0)
# A rover that drives onto a slope (Reina 2008, Fig. 8): some degrees within some decimetres.
STEADY: Final = Pace(walk=math.radians(1.0), trend=math.radians(3.0), length=1.0)
PACES: Final = (QUICK, STEADY)
