"""The cameras of the ground-watching system, as a scenario file describes them."""

from __future__ import annotations

from scenarios.options.base import Options, quantity


class GroundRigOptions(Options):
    """Two like cameras under the trailer that look straight down; their rate, latency and noise are the rig's."""

    width: int = quantity(480, "px", ge=160, le=2048)  # along the trailer
    height: int = quantity(480, "px", ge=160, le=2048)  # across it
    hfov_deg: float = quantity(70.0, "deg", ge=20.0, le=90.0)  # 1.4 m of ground from 1 m up
    camera_height: float = quantity(1.0, "m", ge=0.5, le=1.5)  # above the ground: under the frame of a semi-trailer
    front: float = quantity(1.5, "m", ge=0.0, le=10.0)  # front camera behind the hitch: clear of the tractor's wheels
    rear: float = quantity(0.5, "m", ge=-5.0, le=5.0)  # rear camera ahead of the follow point
