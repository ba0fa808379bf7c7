"""Mounting of the stereo cameras, and their calibration.

The calibration is all that an estimator knows of the rig: it comes from a simulated rig or from the file of a
recording.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from sensors.camera.lens import UNDISTORTED, CameraModel, Distortion, RawStereoRig
from vehicle.frames import R_BODY_CAMERA, FloatArray, rotation_zyx, transform

Facing = Literal["rear", "left", "right", "down"]
# Yaw and pitch of the optical axis; the upper edge of an image straight down lies ahead.
_ATTITUDE: Final[dict[Facing, tuple[float, float]]] = {
    "rear": (math.pi, 0.0),
    "left": (math.pi / 2, 0.0),
    "right": (-math.pi / 2, 0.0),
    "down": (0.0, math.pi / 2),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoCalibration:
    """A rectified stereo pair: two equal pinholes, the right one at ``baseline`` along the left one's x axis."""

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

    @classmethod
    def of_view(cls, width: int, height: int, hfov: float, *, baseline: float, X_SC: FloatArray) -> StereoCalibration:
        """Calibration of cameras with a horizontal field of view of ``hfov`` [rad], centred in their images."""
        return cls(
            width=width,
            height=height,
            focal_length=0.5 * width / math.tan(0.5 * hfov),
            cx=0.5 * (width - 1),
            cy=0.5 * (height - 1),
            baseline=baseline,
            X_SC=X_SC,
        )

    @property
    def X_ClCr(self) -> FloatArray:
        """Pose (4, 4) of the right camera in the left one."""
        return transform(np.eye(3), np.array([self.baseline, 0.0, 0.0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoRig:
    """A stereo pair on the trailer that looks level to the rear or to a side, or straight down at the ground."""

    facing: Facing
    width: int  # [px]
    height: int  # [px]
    hfov: float  # horizontal field of view [rad]
    x: float  # middle of the pair, from the hitch [m], negative behind it
    y: float  # [m], + left
    z: float  # above the ground [m]
    baseline: float  # [m]

    def calibration(self) -> StereoCalibration:
        """Exact calibration of this rig; the pair is centred on (x, y, z)."""
        R_SC = rotation_zyx(*_ATTITUDE[self.facing], 0.0) @ R_BODY_CAMERA
        p_SC = np.array([self.x, self.y, self.z]) - R_SC @ np.array([0.5 * self.baseline, 0.0, 0.0])
        return StereoCalibration.of_view(
            self.width, self.height, self.hfov, baseline=self.baseline, X_SC=transform(R_SC, p_SC)
        )

    def raw(self, distortion: Distortion = UNDISTORTED, R_ClCr: FloatArray | None = None) -> RawStereoRig:
        """This rig with lens distortion, and the right camera turned by ``R_ClCr`` (3, 3) about its optical centre."""
        ideal = self.calibration()
        camera = CameraModel(
            width=ideal.width,
            height=ideal.height,
            fx=ideal.focal_length,
            fy=ideal.focal_length,
            cx=ideal.cx,
            cy=ideal.cy,
            distortion=distortion,
        )
        R = np.eye(3) if R_ClCr is None else R_ClCr
        return RawStereoRig(left=camera, right=camera, X_ClCr=transform(R, ideal.X_ClCr[:3, 3]), X_SC=ideal.X_SC)


def ground_watching_pair(
    width: int, height: int, hfov: float, *, front_x: float, rear_x: float, z: float
) -> StereoCalibration:
    """Two equal cameras below the chassis that look straight down (Miao's ground-watching navigation system).

    One is near the fifth wheel, one near the follow point, as described in section 1.2 of C. de Saxe, D. Cebon,
    "Estimation of trailer off-tracking using visual odometry", Vehicle System Dynamics, 2018. ``left`` is the front
    camera, ``right`` the rear one.

    Args:
        width: along the trailer [px].
        height: across it [px].
        hfov: field of view along the trailer [rad].
        front_x: the front camera, from the hitch [m], negative behind it.
        rear_x: the rear camera [m].
        z: both, above the ground [m].

    Raises:
        ValueError: if the rear camera is not behind the front one.
    """
    if not rear_x < front_x:
        raise ValueError(f"rear_x = {rear_x} m must be less than front_x = {front_x} m")
    # The image's columns run to the rear (x of C against x of S), its rows to the left, the camera looks down. The
    # rear camera then lies on the front one's x axis, as the right camera of any pair lies on the left one's.
    X_SC = transform(np.diag([-1.0, 1.0, -1.0]), np.array([front_x, 0.0, z]))
    return StereoCalibration.of_view(width, height, hfov, baseline=front_x - rear_x, X_SC=X_SC)
