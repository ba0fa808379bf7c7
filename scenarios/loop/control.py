"""Schedule of the controllers: the driver and the trailers' steering laws act at the same moments."""

from __future__ import annotations

from typing import Final

from controllers.driver import PERIOD
from vehicle.clock import Schedule, to_ticks

CONTROL: Final = Schedule(period=to_ticks(PERIOD, "control period"))
