"""Features of an image of the ground, with their positions on it.

FAST corners, as in Miao's system, with SIFT descriptors. Miao's SURF is patented and not part of OpenCV's main modules;
SIFT is the descriptor that SURF approximates, its patent has expired, and it takes 7 ms for 300 corners at one scale.
The cameras keep their height, so one scale is enough. The trailer's yaw is known to a few degrees from its own motion,
so descriptors are aligned with the ground instead of the dominant gradient.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage
from vehicle.frames import FloatArray

_THRESHOLDS = (20, 8)  # of FAST [grey levels]; the second one for ground with little texture
_ENOUGH = 600  # corners at the first threshold; with fewer the second one is used
_BUCKET = 60  # [px]
_PER_BUCKET = 5  # 320 corners in an image of 480x480 px
_SIZE = 5.0  # size of a keypoint, in SIFT's units; larger ones match no better and take longer [px]
_BORDER = 12  # half of the descriptor's patch [px]
_REFINE = (3, 3)  # half window of the sub-pixel refinement [px]
_REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 10, 0.02)
_FARTHEST = 1.5  # largest refinement; beyond it another corner was found [px]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundView:
    """Features of one image."""

    positions: FloatArray  # (n, 2) on the ground, in the trailer frame S at capture [m]
    descriptors: NDArray[np.float32]  # (n, 128), aligned with the ground


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundCamera:
    """A pinhole over level ground."""

    focal_length: float  # [px]
    cx: float  # [px]
    cy: float  # [px]
    X_SC: FloatArray  # (4, 4)

    def on_ground(self, pixels: FloatArray) -> FloatArray:
        """Intersections (n, 2) of the rays through pixels (n, 2) with the ground z = 0, in S [m]."""
        rays = np.column_stack([(pixels - (self.cx, self.cy)) / self.focal_length, np.ones(len(pixels))])
        along = rays @ self.X_SC[:3, :3].T
        reach = -self.X_SC[2, 3] / along[:, 2]
        return np.asarray(self.X_SC[:2, 3] + reach[:, None] * along[:, :2], dtype=np.float64)

    def in_image(self, positions: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 2) on the ground."""
        rays = np.column_stack([positions, np.zeros(len(positions))]) - self.X_SC[:3, 3]
        along = rays @ self.X_SC[:3, :3]
        return np.asarray(self.focal_length * along[:, :2] / along[:, 2:] + (self.cx, self.cy), dtype=np.float64)


def ground_cameras(calibration: StereoCalibration) -> tuple[GroundCamera, GroundCamera]:
    """Front (left) and rear (right) camera of a pair under the trailer.

    Raises:
        ValueError: if they do not look down at the ground.
    """
    height, down = float(calibration.X_SC[2, 3]), float(-calibration.X_SC[2, 2])
    if not (height > 0.0 and down > math.cos(math.radians(20.0))):  # beyond it the image's edge nears the horizon
        raise ValueError(
            f"cameras {height} m above the ground, {math.degrees(math.acos(down)):.0f} deg off the vertical: "
            "ground-watching needs cameras above the ground that look down within 20 deg"
        )
    X_SCs = calibration.X_SC, calibration.X_SC @ calibration.X_ClCr
    front, rear = (
        GroundCamera(focal_length=calibration.focal_length, cx=calibration.cx, cy=calibration.cy, X_SC=X_SC)
        for X_SC in X_SCs
    )
    return front, rear


def viewed(camera: GroundCamera, image: GreyImage, heading: float) -> GroundView:
    """Features of an image taken at about the yaw ``heading`` [rad] of the trailer since the start."""
    pixels = _refined(image, _corners(image))
    angle = math.degrees(heading) % 360.0  # the ground turns to the right seen from above, and mirrored in the image
    keypoints = [cv2.KeyPoint(float(u), float(v), _SIZE, angle) for u, v in pixels]
    if not keypoints:
        return GroundView(positions=np.empty((0, 2)), descriptors=np.empty((0, 128), np.float32))
    described, descriptors = cv2.SIFT.create().compute(image, keypoints)
    kept = np.array([keypoint.pt for keypoint in described], dtype=np.float64)
    return GroundView(positions=camera.on_ground(kept), descriptors=np.asarray(descriptors, dtype=np.float32))


def _corners(image: GreyImage) -> NDArray[np.float32]:
    """The strongest FAST corners of each bucket (n, 2)."""
    for threshold in _THRESHOLDS:
        corners = cv2.FastFeatureDetector.create(threshold).detect(image)
        if len(corners) >= _ENOUGH:
            break
    points = np.array([corner.pt for corner in corners], dtype=np.float32).reshape(-1, 2)
    strength = np.array([corner.response for corner in corners])
    last = np.array(image.shape[::-1]) - 1 - _BORDER
    inside = ((points >= _BORDER) & (points <= last)).all(axis=1)
    points, strength = points[inside], strength[inside]
    bucket = (points[:, 1] // _BUCKET) * 1000 + points[:, 0] // _BUCKET
    order = np.lexsort((points[:, 0], points[:, 1], -strength, bucket))
    starts = np.flatnonzero(np.diff(bucket[order], prepend=-1.0))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    return points[order[rank < _PER_BUCKET]]


def _refined(image: GreyImage, corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Corners refined to a fraction of a pixel."""
    if len(corners) == 0:
        return corners
    refined = cv2.cornerSubPix(image, corners.copy(), _REFINE, (-1, -1), _REFINED)
    close = np.abs(refined - corners).max(axis=1) < _FARTHEST
    return np.where(close[:, None], refined, corners)
