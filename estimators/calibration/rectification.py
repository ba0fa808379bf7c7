"""Rectification of raw stereo pairs: the rows of the result are epipolar lines, as every odometry expects.

Fusiello 2000: A. Fusiello, E. Trucco, A. Verri, "A compact algorithm for rectification of stereo pairs", Machine
Vision and Applications, 2000: both cameras are rotated about their optical centres to parallel axes, with x along the
baseline. Lens distortion is removed in the same step, so that images are sampled once.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.rig import CameraModel, RawStereoRig, StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, transform

_EDGE_STEP = 4  # between the sampled pixels along an image's edge [px]
_LARGEST_CROP = 2.0  # largest ratio of the focal length to that of the cameras; beyond it the common view is too small
_SAME = 1e-9  # maps with smaller shifts are left out [px]


class _Map(NamedTuple):
    """Raw-image coordinates (height, width) of the pixels of a rectified image."""

    u: NDArray[np.float32]  # [px]
    v: NDArray[np.float32]  # [px]


class Rectifier:
    """Rectifier of the image pairs of one raw rig.

    The rectified image has the size of the left raw one and no empty corners: its focal length is that of the cameras,
    or longer if a lens or an angle between the cameras requires it.
    """

    def __init__(self, raw: RawStereoRig) -> None:
        """For a calibrated rig.

        Raises:
            ValueError: if the two cameras see too little in common.
        """
        R_ClC = _common_axes(raw)
        cameras = ((raw.left, R_ClC), (raw.right, raw.X_ClCr[:3, :3].T @ R_ClC))
        self._raw = raw
        self.calibration = _calibration(raw, R_ClC, cameras)  # of the rectified pair
        self._maps = [_map(self.calibration, camera, R) for camera, R in cameras]

    def step(self, frame: StereoFrame) -> StereoFrame:
        """Rectified pair of a raw one.

        Raises:
            ValueError: if an image does not have the calibrated size.
        """
        left, right = (
            _rectified(image, camera, remap, side)
            for image, camera, remap, side in (
                (frame.left, self._raw.left, self._maps[0], "left"),
                (frame.right, self._raw.right, self._maps[1], "right"),
            )
        )
        colour = frame.colour
        if colour is not None and self._maps[0] is not None:
            colour = np.asarray(cv2.remap(colour, *self._maps[0], cv2.INTER_LINEAR), dtype=np.uint8)
        return replace(frame, left=left, right=right, colour=colour)


def _common_axes(raw: RawStereoRig) -> FloatArray:
    """R_ClC (3, 3) of the rectified cameras in the raw left one: x along the baseline, z between the optical axes."""
    baseline = raw.X_ClCr[:3, 3]
    x = baseline / np.linalg.norm(baseline)
    ahead = np.array([0.0, 0.0, 1.0]) + raw.X_ClCr[:3, 2]
    z = ahead - (ahead @ x) * x
    z /= np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def _calibration(
    raw: RawStereoRig, R_ClC: FloatArray, cameras: tuple[tuple[CameraModel, FloatArray], ...]
) -> StereoCalibration:
    """Calibration with the principal point in the centre of the common view and the shortest possible focal length."""
    width, height = raw.left.width, raw.left.height
    low, high = _common_view(cameras)
    own = 0.25 * (raw.left.fx + raw.left.fy + raw.right.fx + raw.right.fy)
    size = np.array([width - 1, height - 1])
    focal_length = max(own, float((size / (high - low)).max()))
    if not focal_length < _LARGEST_CROP * own or (high <= low).any():
        angle = np.degrees(np.arccos(np.clip(0.5 * (np.trace(raw.X_ClCr[:3, :3]) - 1.0), -1.0, 1.0)))
        raise ValueError(
            f"the two cameras see too little in common to be rectified: they are turned {angle:.1f} deg against each "
            "other"
        )
    c = 0.5 * np.array([raw.left.cx + raw.right.cx, raw.left.cy + raw.right.cy])
    cx, cy = np.clip(c, size - focal_length * high, -focal_length * low)
    return StereoCalibration(
        width=width,
        height=height,
        focal_length=focal_length,
        cx=float(cx),
        cy=float(cy),
        baseline=raw.baseline,
        X_SC=raw.X_SC @ transform(R_ClC, np.zeros(3)),
    )


def _common_view(cameras: tuple[tuple[CameraModel, FloatArray], ...]) -> tuple[FloatArray, FloatArray]:
    """Least and greatest x and y of the largest axis-aligned rectangle of rays that both cameras see."""
    low, high = np.full(2, -np.inf), np.full(2, np.inf)
    for camera, R in cameras:
        left, right, top, bottom = (_turned(camera.rays(edge), R.T) for edge in _edges(camera))
        low = np.maximum(low, [left[:, 0].max(), top[:, 1].max()])
        high = np.minimum(high, [right[:, 0].min(), bottom[:, 1].min()])
    return low, high


def _edges(camera: CameraModel) -> Iterator[FloatArray]:
    """Pixels (n, 2) along the left, right, top and bottom edge."""
    u = np.append(np.arange(0.0, camera.width - 1.0, _EDGE_STEP), camera.width - 1.0)
    v = np.append(np.arange(0.0, camera.height - 1.0, _EDGE_STEP), camera.height - 1.0)
    for column in (u[0], u[-1]):
        yield np.column_stack([np.full_like(v, column), v])
    for row in (v[0], v[-1]):
        yield np.column_stack([u, np.full_like(u, row)])


def _turned(rays: FloatArray, R: FloatArray) -> FloatArray:
    """Rays (..., 2) of depth 1 in axes rotated by R (3, 3)."""
    turned = rays @ R[:, :2].T + R[:, 2]
    return turned[..., :2] / turned[..., 2:]


def _map(calibration: StereoCalibration, camera: CameraModel, R: FloatArray) -> _Map | None:
    """Map for one camera, with R of the rectified camera in it; None for the identity."""
    u, v = np.meshgrid(np.arange(calibration.width), np.arange(calibration.height))
    rectified = np.stack([u, v], axis=-1).astype(np.float64)
    rays = (rectified - [calibration.cx, calibration.cy]) / calibration.focal_length
    pixels = camera.pixels(_turned(rays, R))
    if np.abs(pixels - rectified).max() < _SAME:
        return None
    return _Map(pixels[..., 0].astype(np.float32), pixels[..., 1].astype(np.float32))


def _rectified(image: GreyImage, camera: CameraModel, remap: _Map | None, side: str) -> GreyImage:
    if image.shape != (camera.height, camera.width):
        raise ValueError(
            f"the {side} image has {image.shape[1]}x{image.shape[0]} px, "
            f"its camera was calibrated with {camera.width}x{camera.height} px"
        )
    if remap is None:
        return image
    # linear: OpenCV's cubic kernel shifts features by up to 0.04 px, and takes four times as long
    rectified = cv2.remap(image, *remap, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(rectified, dtype=np.uint8)
