"""Options of VISO-OT: storing and smoothing of the hitch's path."""

from __future__ import annotations

from estimators.off_tracking.buffer import REVERSING
from scenarios.options.base import Options, option, quantity


class VisoOtOptions(Options):
    """The buffer of ``off_tracking = "viso_ot"``."""

    smoothing: bool = option("Smooth the motions in the buffer with a Kalman filter.", False)
    reversing_distance: float = quantity(
        REVERSING, "m", 0.0, 200.0, "Distance of reversing for which the path is kept."
    )
