"""How VISO-OT keeps and smooths the hitch's path, as a scenario file describes it."""

from __future__ import annotations

from estimators.off_tracking.buffer import REVERSING
from scenarios.options.base import Options, quantity


class VisoOtOptions(Options):
    """The buffer of ``off_tracking = "viso_ot"``."""

    smoothing: bool = False  # a Kalman filter of the motions that fill it, with a fixed lag for the path behind
    reversing_distance: float = quantity(REVERSING, "m", ge=0.0, le=200.0)  # for which the path is kept
