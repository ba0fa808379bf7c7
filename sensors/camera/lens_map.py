"""Look-up tables from the image of a rendered pinhole to that of a camera with a distorting lens."""

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

_MARGIN: Final = 2  # of the pinhole image around the camera's view, for cubic interpolation [px]
_LARGEST: Final = 4096  # side of a pinhole image that is rendered in reasonable time [px]


@dataclass(frozen=True, slots=True, eq=False)
class LensMap:
    """Pixels of one camera in the image of a pinhole with the same pose."""

    rays: Floats  # (height, width, 2) x and y at depth 1 of each camera pixel's ray
    pixels: Floats  # (height, width, 2) u, v in the pinhole image [px]
    is_identity: bool

    @classmethod
    def of(cls, camera: CameraModel, pinhole: StereoCalibration) -> LensMap:
        """Map for a pinhole whose image covers the camera's view."""
        v, u = np.mgrid[0.0 : camera.height, 0.0 : camera.width]
        rays = camera.rays(np.stack([u, v], axis=-1))
        pixels = rays * pinhole.focal_length + [pinhole.cx, pinhole.cy]
        same = (
            pixels.shape[:2] == (pinhole.height, pinhole.width)
            and np.abs(pixels - np.stack([u, v], axis=-1)).max() < 1e-6
        )
        return cls(rays.astype(np.float32), pixels.astype(np.float32), bool(same))

    def apply(
        self, image: NDArray[np.uint8], shift: Floats | None = None, interpolation: int = cv2.INTER_CUBIC
    ) -> NDArray[np.uint8]:
        """Camera image (height, width) or (height, width, 3) from the pinhole image.

        Args:
            image: of the pinhole.
            shift: offset of each look-up (height, width, 2) [px].
            interpolation: flag of OpenCV.
        """
        if shift is None and self.is_identity:
            return image
        pixels = self.pixels if shift is None else self.pixels + shift
        return np.asarray(resampled(image, pixels, interpolation), dtype=np.uint8)


def resampled(image: NDArray[np.uint8] | Floats, pixels: Floats, interpolation: int) -> NDArray[np.generic]:
    """Image looked up at u, v (h, w, 2) [px]; outside of it the nearest edge pixel is taken."""
    u, v = cv2.split(pixels)
    return np.asarray(cv2.remap(image, u, v, interpolation, borderMode=cv2.BORDER_REPLICATE))


def covering_pinholes(rig: RawStereoRig, margin: int = 0) -> StereoCalibration:
    """Smallest pinhole pair whose images cover the view of both cameras of a rig, plus ``margin`` px on all sides.

    In the middle of the image its resolution is that of the cameras, so that the renderer's anti-aliasing is kept
    there. Towards the edges of a lens with barrel distortion it is finer, which only costs time.

    Raises:
        ValueError: if no pinhole image of reasonable size covers the view.
    """
    cameras = (rig.left, rig.right)
    f = max(max(camera.fx, camera.fy) for camera in cameras)
    plain = all(camera.distortion == UNDISTORTED and camera.fx == camera.fy == f for camera in cameras)
    wider = margin if plain and rig.left == rig.right else margin + _MARGIN
    edges = np.concatenate([camera.rays(_border(camera)) for camera in cameras])
    low, high = np.round(edges.min(axis=0) * f, 9), np.round(edges.max(axis=0) * f, 9)
    middle = np.array([rig.left.cx, rig.left.cy])
    low = np.floor(low + middle) - middle  # without distortion, pixels then coincide
    width, height = (math.ceil(side - 1e-6) + 1 + 2 * wider for side in high - low)
    if max(width, height) > _LARGEST:
        raise ValueError(
            f"the cameras cover {width}x{height} px of an undistorted image; at most {_LARGEST} px can be rendered: "
            "choose a lower resolution, a narrower view or less distortion"
        )
    cx, cy = wider - low
    return StereoCalibration(
        width=width, height=height, focal_length=f, cx=cx, cy=cy, baseline=rig.baseline, X_SC=rig.X_SC
    )


def _border(camera: CameraModel) -> NDArray[np.float64]:
    """Outermost pixels of a camera's image (n, 2)."""
    u, v = np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float)
    sides = [(u, 0.0 * u), (u, 0.0 * u + v[-1]), (0.0 * v, v), (0.0 * v + u[-1], v)]
    return np.concatenate([np.stack(side, axis=-1) for side in sides])
