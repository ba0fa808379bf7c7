"""What a camera over the ground saw: features with the places they have on it.

FAST corners, as Miao used them, described by SIFT. His SURF is patented and not part of OpenCV's main modules; SIFT is
the descriptor SURF was made to approximate, its patent has expired, and it costs 7 ms for 300 corners at one scale.
The cameras keep their height, so scales are not searched; and the way the trailer has turned is known to a few degrees
from its own motion, so descriptors are aligned with the ground instead of with whatever gradient prevails.
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

_THRESHOLDS = (20, 8)  # of FAST [grey levels]; the second one for ground that shows little
_ENOUGH = 600  # corners at the first threshold, else the second one is tried
_BUCKET = 60  # [px]
_PER_BUCKET = 5  # 320 corners in an image of 480x480 px
_SIZE = 5.0  # of a described patch, in SIFT's units; larger ones match no better and take longer [px]
_BORDER = 12  # half of what the descriptor looks at [px]
_REFINE = (3, 3)  # half window of the sub-pixel refinement [px]
_REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 10, 0.02)
_FARTHEST = 1.5  # a refinement that goes farther has found another corner [px]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundView:
    """Features of one image."""

    places: FloatArray  # (n, 2) on the ground, in the trailer frame S at capture [m]
    descriptors: NDArray[np.float32]  # (n, 128), aligned with the ground


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundCamera:
    """A pinhole over level ground."""

    focal_length: float  # [px]
    cx: float  # [px]
    cy: float  # [px]
    X_SC: FloatArray  # (4, 4)

    def on_ground(self, pixels: FloatArray) -> FloatArray:
        """Where in S the rays through pixels (n, 2) meet the ground z = 0 (n, 2) [m]."""
        rays = np.column_stack([(pixels - (self.cx, self.cy)) / self.focal_length, np.ones(len(pixels))])
        along = rays @ self.X_SC[:3, :3].T
        reach = -self.X_SC[2, 3] / along[:, 2]
        return np.asarray(self.X_SC[:2, 3] + reach[:, None] * along[:, :2], dtype=np.float64)

    def in_image(self, places: FloatArray) -> FloatArray:
        """Pixels (n, 2) at which places (n, 2) on the ground are seen."""
        seen = np.column_stack([places, np.zeros(len(places))]) - self.X_SC[:3, 3]
        along = seen @ self.X_SC[:3, :3]
        return np.asarray(self.focal_length * along[:, :2] / along[:, 2:] + (self.cx, self.cy), dtype=np.float64)


def ground_cameras(calibration: StereoCalibration) -> tuple[GroundCamera, GroundCamera]:
    """The front (left) and the rear (right) camera of a pair under the trailer.

    Raises:
        ValueError: if they do not look down at the ground.
    """
    height, down = float(calibration.X_SC[2, 3]), float(-calibration.X_SC[2, 2])
    if not (height > 0.0 and down > math.cos(math.radians(20.0))):  # more and the image's edge nears the horizon
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
    """The features of an image taken while the trailer was turned by about ``heading`` [rad] from where it began."""
    pixels = _refined(image, _corners(image))
    angle = math.degrees(heading) % 360.0  # seen from above the ground turns to the right; the camera sees it mirrored
    keypoints = [cv2.KeyPoint(float(u), float(v), _SIZE, angle) for u, v in pixels]
    if not keypoints:
        return GroundView(places=np.empty((0, 2)), descriptors=np.empty((0, 128), np.float32))
    described, descriptors = cv2.SIFT.create().compute(image, keypoints)
    kept = np.array([keypoint.pt for keypoint in described], dtype=np.float64)
    return GroundView(places=camera.on_ground(kept), descriptors=np.asarray(descriptors, dtype=np.float32))


def _corners(image: GreyImage) -> NDArray[np.float32]:
    """The strongest FAST corners of each bucket (n, 2)."""
    for threshold in _THRESHOLDS:
        found = cv2.FastFeatureDetector.create(threshold).detect(image)
        if len(found) >= _ENOUGH:
            break
    points = np.array([corner.pt for corner in found], dtype=np.float32).reshape(-1, 2)
    strength = np.array([corner.response for corner in found])
    last = np.array(image.shape[::-1]) - 1 - _BORDER
    inside = ((points >= _BORDER) & (points <= last)).all(axis=1)
    points, strength = points[inside], strength[inside]
    bucket = (points[:, 1] // _BUCKET) * 1000 + points[:, 0] // _BUCKET
    order = np.lexsort((points[:, 0], points[:, 1], -strength, bucket))
    starts = np.flatnonzero(np.diff(bucket[order], prepend=-1.0))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    return points[order[rank < _PER_BUCKET]]


def _refined(image: GreyImage, corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """The corners to a fraction of a pixel."""
    if len(corners) == 0:
        return corners
    refined = cv2.cornerSubPix(image, corners.copy(), _REFINE, (-1, -1), _REFINED)
    close = np.abs(refined - corners).max(axis=1) < _FARTHEST
    return np.where(close[:, None], refined, corners)
