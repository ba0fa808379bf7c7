"""From the image of a pinhole to that of a real camera: where each pixel of the one is found in the other."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.lens import UNDISTORTED, CameraModel, RawStereoRig
from sensors.camera.rig import StereoCalibration

Floats = NDArray[np.float32]

_MARGIN: Final = 2  # of the pinhole's image around all that a camera sees: what cubic interpolation reaches for [px]
_LARGEST: Final = 4096  # side of a pinhole's image that is still drawn in reasonable time [px]


@dataclass(frozen=True, slots=True, eq=False)
class LensMap:
    """Pixels of one real camera in the image of a pinhole that stands where the camera does."""

    rays: Floats  # (height, width, 2) x and y at depth 1 that each pixel of the camera sees
    at: Floats  # (height, width, 2) u, v in the pinhole's image [px]
    is_identity: bool

    @classmethod
    def of(cls, camera: CameraModel, pinhole: StereoCalibration) -> LensMap:
        """The map of a camera for a pinhole that sees all the camera sees."""
        v, u = np.mgrid[0.0 : camera.height, 0.0 : camera.width]
        rays = camera.rays(np.stack([u, v], axis=-1))
        at = rays * pinhole.focal_length + [pinhole.cx, pinhole.cy]
        same = at.shape[:2] == (pinhole.height, pinhole.width) and np.abs(at - np.stack([u, v], axis=-1)).max() < 1e-6
        return cls(rays.astype(np.float32), at.astype(np.float32), bool(same))

    def seen(
        self, image: NDArray[np.uint8], shift: Floats | None = None, interpolation: int = cv2.INTER_CUBIC
    ) -> NDArray[np.uint8]:
        """The camera's image (height, width) or (height, width, 3) of a pinhole's, looked up ``shift`` px beside."""
        if shift is None and self.is_identity:
            return image
        at = self.at if shift is None else self.at + shift
        return np.asarray(resampled(image, at, interpolation), dtype=np.uint8)


def resampled(image: NDArray[np.uint8] | Floats, at: Floats, interpolation: int) -> NDArray[np.generic]:
    """The image looked up at u, v (h, w, 2) [px]; beyond its edge it goes on as it is there."""
    u, v = cv2.split(at)
    return np.asarray(cv2.remap(image, u, v, interpolation, borderMode=cv2.BORDER_REPLICATE))


def covering(rig: RawStereoRig, margin: int = 0) -> StereoCalibration:
    """The smallest pinhole pair that sees all that both cameras of a rig see, ``margin`` px around it.

    One pixel of it is one of the cameras in their middle, so that nothing of the renderer's smoothing is lost there;
    barrel distortion then shrinks towards the edges, which costs nothing but time.

    Raises:
        ValueError: if a lens sees so much that no pinhole of a reasonable size does.
    """
    cameras = (rig.left, rig.right)
    f = max(max(camera.fx, camera.fy) for camera in cameras)
    plain = all(camera.distortion == UNDISTORTED and camera.fx == camera.fy == f for camera in cameras)
    wider = margin if plain and rig.left == rig.right else margin + _MARGIN
    edges = np.concatenate([camera.rays(_border(camera)) for camera in cameras])
    low, high = np.round(edges.min(axis=0) * f, 9), np.round(edges.max(axis=0) * f, 9)
    middle = np.array([rig.left.cx, rig.left.cy])
    low = np.floor(low + middle) - middle  # pixels of the pinhole are then pixels of the camera where it bends nothing
    width, height = (math.ceil(side - 1e-6) + 1 + 2 * wider for side in high - low)
    if max(width, height) > _LARGEST:
        raise ValueError(
            f"cameras that see {width}x{height} px of an undistorted image: at most {_LARGEST} px can be rendered; "
            "take less resolution, a narrower view or less distortion"
        )
    cx, cy = wider - low
    return StereoCalibration(
        width=width, height=height, focal_length=f, cx=cx, cy=cy, baseline=rig.baseline, X_SC=rig.X_SC
    )


def _border(camera: CameraModel) -> NDArray[np.float64]:
    """The outermost pixels of a camera's image (n, 2)."""
    u, v = np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float)
    sides = [(u, 0.0 * u), (u, 0.0 * u + v[-1]), (0.0 * v, v), (0.0 * v + u[-1], v)]
    return np.concatenate([np.stack(side, axis=-1) for side in sides])
