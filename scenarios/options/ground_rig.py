"""Options of the cameras of the ground-watching system."""

from __future__ import annotations

from scenarios.options.base import Options, quantity


class GroundRigOptions(Options):
    """Two equal cameras under the trailer that look straight down; rate, latency and noise are those of ``rig``."""

    width: int = quantity(480, "px", 160, 2048, "Image width, along the trailer.")
    height: int = quantity(480, "px", 160, 2048, "Image height, across the trailer.")
    hfov_deg: float = quantity(
        70.0, "deg", 20.0, 90.0, "Horizontal field of view; at 1 m height, 70 deg cover 1.4 m of ground."
    )
    camera_height: float = quantity(1.0, "m", 0.5, 1.5, "Height of the cameras above the ground.")
    front: float = quantity(1.5, "m", 0.0, 10.0, "Distance of the front camera behind the hitch.")
    rear: float = quantity(0.5, "m", -5.0, 5.0, "Distance of the rear camera ahead of the follow point.")
