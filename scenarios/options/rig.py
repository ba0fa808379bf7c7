"""Cameras, and the world they see, as a scenario file describes them."""

from __future__ import annotations

from typing import Literal

from scenarios.options.base import Options, quantity


class RigOptions(Options):
    """The stereo cameras on the trailer's roof (de Saxe & Cebon 2018, section 3.1)."""

    facing: Literal["rear", "left", "right"] = "rear"
    width: int = quantity(1344, "px", ge=320, le=4096)
    height: int = quantity(391, "px", ge=200, le=4096)
    hfov_deg: float = quantity(100.0, "deg", ge=30.0, le=140.0)
    camera_height: float = quantity(3.0, "m", ge=0.5, le=6.0)  # above the ground
    baseline: float = quantity(0.5, "m", ge=0.1, le=5.0)
    rate_hz: float = quantity(10.0, "Hz", ge=1.0, le=50.0)
    latency: float = quantity(0.1, "s", ge=0.0, le=1.0)  # exposure to finished estimate
    noise: float = quantity(2.0, "grey levels", ge=0.0, le=50.0)  # standard deviation of the image noise


class WorldOptions(Options):
    """What stands beside the road."""

    scenery_density: float = quantity(1.0, "-", ge=0.0, le=2.0)  # 1 is the reference, 0 bare ground
