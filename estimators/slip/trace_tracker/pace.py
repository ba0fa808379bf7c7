"""How fast slip changes: what two filters believe that are run beside each other."""

from __future__ import annotations

import math
from typing import Final, NamedTuple


class Pace(NamedTuple):
    """A walk of slip, and a trend that lasts for some way."""

    walk: float  # per sqrt(m) [rad]
    trend: float  # standard deviation [rad/m]
    way: float  # over which the trend changes [m]


# Slip that varies by 1.6 deg within 5 s at 8 cm/s walks by 3.6 deg/sqrt(m) in the long run.
QUICK: Final = Pace(walk=math.radians(4.0), trend=0.0, way=1.0)
# A rover that drives onto a slope (Reina 2008, Fig. 8): some degrees within some decimetres, and little else.
STEADY: Final = Pace(walk=math.radians(1.0), trend=math.radians(3.0), way=1.0)
PACES: Final = (QUICK, STEADY)
