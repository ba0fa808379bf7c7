"""Where the stereo cameras sit, and what a calibration of them says.

The calibration is all that an estimator gets to know of the rig: the same object comes from a rendered rig or from
a file beside recorded images.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from vehicle.frames import R_BODY_CAMERA, FloatArray, rotation_zyx, transform

Facing = Literal["rear", "left", "right"]
_YAW: Final[dict[Facing, float]] = {"rear": math.pi, "left": math.pi / 2, "right": -math.pi / 2}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoCalibration:
    """A rectified stereo pair: both cameras are the same pinhole, the right one ``baseline`` along the left one's x."""

    width: int  # [px]
    height: int  # [px]
    focal_length: float  # [px]
    cx: float  # principal point, column; the first pixel's centre is 0 [px]
    cy: float  # principal point, row [px]
    baseline: float  # [m]
    X_SC: FloatArray  # (4, 4) pose of the left camera in the trailer body (origin: hitch on the ground)

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0 or self.focal_length <= 0.0:
            raise ValueError(
                f"camera of {self.width}x{self.height} px, focal length {self.focal_length} px: all must be positive"
            )
        if self.baseline <= 0.0:
            raise ValueError(f"baseline = {self.baseline} m must be positive")

    @property
    def X_ClCr(self) -> FloatArray:
        """Pose of the right camera in the left one."""
        return transform(np.eye(3), np.array([self.baseline, 0.0, 0.0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoRig:
    """A stereo pair on the trailer's roof, looking level to the rear or to a side."""

    facing: Facing
    width: int  # [px]
    height: int  # [px]
    hfov: float  # horizontal field of view [rad]
    x: float  # middle of the pair, from the hitch [m], negative behind it
    y: float  # [m], + left
    z: float  # above the ground [m]
    baseline: float  # [m]

    def calibration(self) -> StereoCalibration:
        """The exact calibration of this rig; the pair is centred on (x, y, z)."""
        R_SC = rotation_zyx(_YAW[self.facing], 0.0, 0.0) @ R_BODY_CAMERA
        p_SC = np.array([self.x, self.y, self.z]) - R_SC @ np.array([0.5 * self.baseline, 0.0, 0.0])
        return StereoCalibration(
            width=self.width,
            height=self.height,
            focal_length=0.5 * self.width / math.tan(0.5 * self.hfov),
            cx=0.5 * (self.width - 1),
            cy=0.5 * (self.height - 1),
            baseline=self.baseline,
            X_SC=transform(R_SC, p_SC),
        )
