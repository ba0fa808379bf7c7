"""Cameras, and the world they see, as a scenario file describes them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from scenarios.options.base import Options, quantity
from sensors.camera.lens import UNDISTORTED, Distortion

_Angle = Annotated[float, Field(ge=-5.0, le=5.0)]
_Angles = tuple[_Angle, _Angle, _Angle]  # roll about the optical axis, yaw about the camera's y (down), pitch about x


def _angles() -> _Angles:
    straight: _Angles = Field((0.0, 0.0, 0.0), json_schema_extra={"unit": "deg"})
    return straight


class RigOptions(Options):
    """The stereo cameras on the trailer (de Saxe & Cebon 2018, section 3.1), at first perfect ones."""

    facing: Literal["rear", "left", "right", "down"] = "rear"
    width: int = quantity(1344, "px", ge=320, le=4096)
    height: int = quantity(391, "px", ge=200, le=4096)
    hfov_deg: float = quantity(100.0, "deg", ge=30.0, le=140.0)
    camera_height: float = quantity(3.0, "m", ge=0.5, le=6.0)  # above the ground
    baseline: float = quantity(0.5, "m", ge=0.1, le=5.0)
    rate_hz: float = quantity(10.0, "Hz", ge=1.0, le=50.0)
    latency: float = quantity(0.1, "s", ge=0.0, le=1.0)  # exposure to finished estimate
    noise: float = quantity(2.0, "grey levels", ge=0.0, le=50.0)  # standard deviation of the image noise
    shot_noise: float = quantity(0.0, "grey levels", ge=0.0, le=50.0)  # of the light's own noise, where it is white
    distortion: Distortion = UNDISTORTED  # k1, k2, p1, p2, k3 of OpenCV's model
    calibration: Literal["exact", "boards"] = "exact"  # known to the last digit, or from rendered checkerboards
    misrotation_deg: _Angles = _angles()  # how the right camera has been turned since the calibration
    twist_deg: _Angles = _angles()  # the same by chassis twist, when the trailer is about to roll over to the left
    exposure: Literal["fixed", "auto"] = "fixed"
    exposure_time_constant: float = quantity(0.3, "s", ge=0.01, le=10.0)  # of the automatic one
    exposure_time_ms: float = quantity(0.0, "ms", ge=0.0, le=50.0)  # motion blurs the image meanwhile
    rolling_shutter_ms: float = quantity(0.0, "ms", ge=0.0, le=50.0)  # from the first row to the last
    vignetting: float = quantity(0.0, "-", ge=0.0, le=1.0)  # share of the light that is lost in the corners
    dirt: float = quantity(0.0, "-", ge=0.0, le=0.9)  # share of the lenses that is behind a crust
    rain: float = quantity(0.0, "-", ge=0.0, le=0.9)  # share of the lenses that is behind drops
    self_calibration: bool = False  # watch how the right camera is turned, and straighten its images
    glare: float = quantity(0.0, "-", ge=0.0, le=5.0)  # of the sun on the lenses: 1 is a dusty lens


class WorldOptions(Options):
    """What stands beside the road, and the light."""

    scenery_density: float = quantity(1.0, "-", ge=0.0, le=2.0)  # 1 is the reference, 0 bare ground
    sun_azimuth_deg: float | None = quantity(None, "deg", ge=0.0, le=360.0)  # as on a compass, 270 is west
    sun_elevation_deg: float | None = quantity(None, "deg", ge=3.0, le=90.0)  # above the horizon
    overcast: bool = False
    tarmac_width: float | None = quantity(None, "m", ge=9.0, le=200.0)  # around the course; none: a road
    tarmac_patches: float = quantity(0.0, "1/100 m2", ge=0.0, le=50.0)  # mended places
    grain: bool = False  # fields of it all around
