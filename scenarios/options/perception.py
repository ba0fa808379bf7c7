"""Options of the cameras, the rendered world, and the combination's own sensors."""

from typing import Annotated, Literal

from pydantic import Field

from sensors.camera.lens import UNDISTORTED, Distortion
from vehicle.foundation.quantity import Frozen, option, quantity

_Angle = Annotated[float, Field(ge=-5.0, le=5.0)]
_Angles = tuple[_Angle, _Angle, _Angle]  # roll about the optical axis, yaw about the camera's y (down), pitch about x


def _angles(meaning: str) -> _Angles:
    straight: _Angles = Field((0.0, 0.0, 0.0), description=meaning, json_schema_extra={"unit": "deg"})
    return straight


class RigOptions(Frozen):
    """The stereo cameras on the trailer (de Saxe & Cebon 2018, section 3.1), without imperfections by default."""

    facing: Literal["rear", "left", "right", "down"] = option("Direction in which the cameras look.", "rear")
    width: int = quantity(1344, "px", 320, 4096, "Image width.")
    height: int = quantity(391, "px", 200, 4096, "Image height.")
    hfov_deg: float = quantity(100.0, "deg", 30.0, 140.0, "Horizontal field of view.")
    camera_height: float = quantity(3.0, "m", 0.5, 6.0, "Height of the cameras above the ground.")
    baseline: float = quantity(0.5, "m", 0.1, 5.0, "Distance between the two cameras.")
    rate_hz: float = quantity(10.0, "Hz", 1.0, 50.0, "Frame rate.")
    latency: float = quantity(0.1, "s", 0.0, 1.0, "Time from exposure to the finished estimate.")
    noise: float = quantity(
        2.0, "grey levels", 0.0, 50.0, "Standard deviation of the image noise that is independent of the light."
    )
    shot_noise: float = quantity(
        0.0, "grey levels", 0.0, 50.0, "Standard deviation of the shot noise of a white pixel."
    )
    distortion: Distortion = option("Coefficients k1, k2, p1, p2, k3 of OpenCV's lens model.", UNDISTORTED)
    calibration: Literal["exact", "boards"] = option(
        "exact: known exactly; boards: calibrated from rendered checkerboards.", "exact"
    )
    misrotation_deg: _Angles = _angles("Roll, yaw, pitch of the right camera since its calibration.")
    twist_deg: _Angles = _angles(
        "Roll, yaw, pitch of the right camera by chassis twist at the rollover limit to the left."
    )
    exposure: Literal["fixed", "auto"] = option("Fixed or automatic exposure.", "fixed")
    exposure_time_constant: float = quantity(0.3, "s", 0.01, 10.0, "Time constant of the automatic exposure.")
    exposure_time_ms: float = quantity(0.0, "ms", 0.0, 50.0, "Exposure time, during which motion blurs the image.")
    rolling_shutter_ms: float = quantity(0.0, "ms", 0.0, 50.0, "Time from the first image row to the last.")
    vignetting: float = quantity(0.0, "-", 0.0, 1.0, "Share of the light lost in the image corners.")
    dirt: float = quantity(0.0, "-", 0.0, 0.9, "Share of the lenses covered by dirt.")
    rain: float = quantity(0.0, "-", 0.0, 0.9, "Share of the lenses covered by drops.")
    self_calibration: bool = option(
        "Estimate the rotation of the right camera while driving, and correct its images.", False
    )
    glare: float = quantity(0.0, "-", 0.0, 5.0, "Glare of the sun on the lenses; 1 is a dusty lens.")


class WorldOptions(Frozen):
    """Scenery along the road, and the light."""

    scenery_density: float = quantity(1.0, "-", 0.0, 2.0, "Density of the scenery; 1 is the reference, 0 bare ground.")
    sun_azimuth_deg: float | None = quantity(
        None, "deg", 0.0, 360.0, "Compass direction of the sun, 270 is west; not given: decided by the seed."
    )
    sun_elevation_deg: float | None = quantity(
        None, "deg", 3.0, 90.0, "Elevation of the sun above the horizon; not given: decided by the seed."
    )
    overcast: bool = option("Overcast sky without direct sun.", False)
    tarmac_width: float | None = quantity(
        None, "m", 9.0, 200.0, "Width of the tarmac around the course; not given: a road."
    )
    tarmac_patches: float = quantity(0.0, "1/100 m2", 0.0, 50.0, "Repaired patches per 100 m2 of tarmac.")
    grain: bool = option("Fields of grain all around.", False)


class GroundRigOptions(Frozen):
    """Two equal cameras under the trailer that look straight down; rate, latency and noise are those of ``rig``."""

    width: int = quantity(480, "px", 160, 2048, "Image width, along the trailer.")
    height: int = quantity(480, "px", 160, 2048, "Image height, across the trailer.")
    hfov_deg: float = quantity(
        70.0, "deg", 20.0, 90.0, "Horizontal field of view; at 1 m height, 70 deg cover 1.4 m of ground."
    )
    camera_height: float = quantity(1.0, "m", 0.5, 1.5, "Height of the cameras above the ground.")
    front: float = quantity(1.5, "m", 0.0, 10.0, "Distance of the front camera behind the hitch.")
    rear: float = quantity(0.5, "m", -5.0, 5.0, "Distance of the rear camera ahead of the follow point.")


SteerGroups = Literal["vehicle", "single", "common_centre"]


class SignalOptions(Frozen):
    """Speed sensor, angle sensors, gyros and accelerometer, for steering laws and no-slip estimators."""

    noise: float = quantity(
        1.0, "-", 0.0, 10.0, "Scale of the errors of speed, angle and motion sensors; 1: data sheets, 0: exact."
    )
