"""Options of VISO-OT: storing and smoothing of the hitch's path, and fusion with signals."""

from __future__ import annotations

from typing import Literal

from estimators.off_tracking.buffer import REVERSING
from scenarios.options.base import Options, option, quantity


class VisoOtOptions(Options):
    """The buffer of ``off_tracking = "viso_ot"``, and its use of signals."""

    smoothing: bool = option("Smooth the motions in the buffer with a Kalman filter.", False)
    reversing_distance: float = quantity(
        REVERSING, "m", 0.0, 200.0, "Distance of reversing for which the path is kept."
    )
    fusion: Literal["signals", "none"] = option(
        "Bridge outages of the cameras, and check them, by the combination's own sensors; none: cameras alone.",
        "signals",
    )
