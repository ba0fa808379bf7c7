"""Stereo pairs: points and their images, a displaced right camera, and corrected pairs.

Points known in the previous camera P are reprojected into the current camera C, linearised in the motion X_PC. The
motion is perturbed as in the covariance of ``estimates.Motion``: R = exp(skew(d_theta)) R_PC, p = p_PC + d_p, both
along the axes of P. Leading axes are several motions at once: R (..., 3, 3) and p (..., 3) with points (..., 3, n).
Components come before points, as NumPy is faster on a few long rows than on many short ones.

A moving camera that exposes late has turned and moved on by then. Its rotation is removed from the image by a
homography; its displacement shifts every point by an amount that depends on the depth. The shift is removed point by
point: right images of matched points are converted to those of a camera at the calibrated position.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray

Points = NDArray[np.float32]  # (n, 2) u, v [px]

NEAREST = 0.5  # least depth of a point [m]; nothing in view is nearer


def triangulate(calibration: StereoCalibration, z: FloatArray) -> FloatArray:
    """Points (..., 3) in the left camera from their images (..., 3) with positive disparity."""
    depth = calibration.focal_length * calibration.baseline / (z[..., 0] - z[..., 2])
    scale = depth / calibration.focal_length
    return np.stack([(z[..., 0] - calibration.cx) * scale, (z[..., 1] - calibration.cy) * scale, depth], axis=-1)


def triangulation_jacobian(calibration: StereoCalibration, p: FloatArray) -> FloatArray:
    """dp/dz (..., 3, 3) of points (..., 3); all coordinates are proportional to 1 / disparity."""
    scale = p[..., 2] / calibration.focal_length
    J = np.zeros((*p.shape, 3))
    J[..., 2] = p * (scale / calibration.baseline)[..., None]
    J[..., 0] = -J[..., 2]
    J[..., 0, 0] += scale
    J[..., 1, 1] = scale
    return J


def project(calibration: StereoCalibration, p: FloatArray) -> FloatArray:
    """Images (..., 3) of points (..., 3) in front of the cameras."""
    scale = calibration.focal_length / p[..., 2]
    z = np.empty_like(p)
    z[..., 0] = p[..., 0] * scale + calibration.cx
    z[..., 1] = p[..., 1] * scale + calibration.cy
    z[..., 2] = z[..., 0] - calibration.baseline * scale
    return z


def _points_in_camera(R: FloatArray, p: FloatArray, points: FloatArray) -> FloatArray:
    """Points (..., 3, n), given in P, in the axes of the camera C at R, p in P."""
    points_C: FloatArray = np.swapaxes(R, -1, -2) @ (points - p[..., None])
    points_C[..., 2, :] = np.maximum(points_C[..., 2, :], NEAREST)
    return points_C


def residuals(
    calibration: StereoCalibration, R: FloatArray, p: FloatArray, points: FloatArray, z: FloatArray
) -> FloatArray:
    """Measured minus predicted images (..., 3, n) [px] of the points after the motion."""
    return z - _images(calibration, _points_in_camera(R, p, points))


def linearised(
    calibration: StereoCalibration, R: FloatArray, p: FloatArray, points: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The ``residuals``, and the derivative (..., 6, 3, n) of the predicted images with respect to (d_theta, d_p)."""
    points_C = _points_in_camera(R, p, points)
    return z - _images(calibration, points_C), _jacobian(calibration, R, points_C)


def _images(calibration: StereoCalibration, points_C: FloatArray) -> FloatArray:
    return np.swapaxes(project(calibration, np.swapaxes(points_C, -1, -2)), -1, -2)


def _jacobian(calibration: StereoCalibration, R: FloatArray, points_C: FloatArray) -> FloatArray:
    """Derivative (..., 6, 3, n) of the images of points in C with respect to the motion.

    p_C = R' exp(-skew(d_theta)) (p_P - p - d_p), so d p_C = p_C x R' d_theta - R' d_p.
    """
    x, y, depth = points_C[..., 0, :], points_C[..., 1, :], points_C[..., 2, :]
    f, scale = calibration.focal_length, calibration.focal_length / depth
    # change of the images with depth
    per_depth = points_C.copy()
    per_depth[..., 2, :] = x - calibration.baseline
    per_depth *= (scale / depth)[..., None, :]
    J = np.zeros((*points_C.shape[:-2], 2, 3, 3, points_C.shape[-1]))  # rotation, translation; axis of C; image; point
    turned, shifted = J[..., 0, :, :, :], J[..., 1, :, :, :]
    shifted[..., 0, ::2, :] = shifted[..., 1, 1:2, :] = -scale[..., None, :]
    shifted[..., 2, :, :] = per_depth
    turned[..., 0, :, :] = per_depth * y[..., None, :]  # rows of -shifted x p_C
    turned[..., 0, 1, :] += f
    turned[..., 1, :, :] = -per_depth * x[..., None, :]
    turned[..., 1, ::2, :] -= f
    turned[..., 2, ::2, :] = (scale * y)[..., None, :]
    turned[..., 2, 1, :] = -scale * x
    along_P: FloatArray = R[..., None, :, :] @ J.reshape(*J.shape[:-2], -1)
    return along_P.reshape(*J.shape[:-4], 6, *J.shape[-2:])


class Turned(NamedTuple):
    """An image as the camera took it, and the homography (3, 3) by which it was resampled."""

    image: GreyImage
    homography: FloatArray

    def resampled(self) -> GreyImage:
        """Image after the homography; edge pixels are repeated."""
        # linear: OpenCV's cubic kernel shifts features by up to 0.04 px, and takes four times as long
        height, width = self.image.shape
        flags, border = cv2.INTER_LINEAR, cv2.BORDER_REPLICATE
        warped = cv2.warpPerspective(self.image, self.homography, (width, height), flags=flags, borderMode=border)
        return np.asarray(warped, dtype=np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CorrectedFrame(StereoFrame):
    """A stereo pair with parallel cameras."""

    turned: Turned  # from which the right image was resampled
    right_shift: FloatArray | None  # (3,) of the right camera from its calibrated position, in the left one [m]


def mapped(image: GreyImage, levels: FloatArray) -> GreyImage:
    """Image whose grey levels become ``levels`` (256,), rounded."""
    table = np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)
    return np.asarray(cv2.LUT(image, table), dtype=np.uint8)


def with_levels(frame: StereoFrame, levels: FloatArray) -> StereoFrame:
    """Frame in whose images grey levels become ``levels`` (256,).

    Resampled images are resampled anew: interpolation moves the edges of what is limited afterwards, but not of what
    the camera itself has clipped, by 0.01 px.
    """
    left, right = mapped(frame.left, levels), mapped(frame.right, levels)
    if not isinstance(frame, CorrectedFrame):
        return replace(frame, left=left, right=right)
    turned = frame.turned._replace(image=mapped(frame.turned.image, levels))
    return replace(frame, left=left, right=turned.resampled(), turned=turned)


Pixels = NDArray[np.floating[Any]]  # (n, 2) u, v [px]
PixelsT = TypeVar("PixelsT", bound=Pixels)

_SHORTEST = 0.3  # least effective baseline, as a share of the calibrated one: nearer to the epipole depth is unknown
_LEAST_AHEAD = 0.2  # least depth in the displaced camera, as a share of that in the calibrated one


def right_shift(frame: StereoFrame) -> FloatArray | None:
    """Displacement (3,) of a frame's right camera [m]; None for an ordinary pair."""
    return frame.right_shift if isinstance(frame, CorrectedFrame) else None


def right_position(calibration: StereoCalibration, shift: FloatArray | None) -> FloatArray:
    """Position (3,) of the right camera in the left one [m]."""
    position = np.array([calibration.baseline, 0.0, 0.0])
    return position if shift is None else position + shift


def as_calibrated(calibration: StereoCalibration, left: Pixels, right: PixelsT, shift: FloatArray | None) -> PixelsT:
    """Right images (n, 2) that a camera at its calibrated position has of the points with these images [px].

    Depth comes from the shift along the epipolar line; the distance from that line is kept as a difference of the rows.
    Points near the epipole, whose depth is unknown, are NaN.
    """
    if shift is None:
        return right
    f, b, c = calibration.focal_length, calibration.baseline, np.array([calibration.cx, calibration.cy])
    r, q = (left - c) / f, (right - c) / f
    # q - r = inverse depth times this
    along = q * shift[2] - np.array([b + shift[0], shift[1]])
    length = np.sqrt((along**2).sum(axis=1))
    inverse_depth = ((q - r) * along).sum(axis=1) / np.maximum(length, _SHORTEST * b) ** 2
    across = (along[:, 0] * (q - r)[:, 1] - along[:, 1] * (q - r)[:, 0]) / np.maximum(length, _SHORTEST * b)
    corrected = np.column_stack([r[:, 0] - b * inverse_depth, r[:, 1] - across])
    corrected[length < _SHORTEST * b] = np.nan
    result: PixelsT = (f * corrected + c).astype(right.dtype)
    return result


def displaced(calibration: StereoCalibration, left: Pixels, right: PixelsT, shift: FloatArray | None) -> PixelsT:
    """Right images (n, 2) in the displaced camera of points with these left and calibrated right images [px]."""
    if shift is None:
        return right
    f, b = calibration.focal_length, calibration.baseline
    inverse_depth = np.maximum((left[:, 0] - right[:, 0]) / (f * b), 0.0)
    seen: Any = right + _image_shift(calibration, right, inverse_depth, shift)
    result: PixelsT = seen.astype(right.dtype)
    return result


def image_shift(calibration: StereoCalibration, points: FloatArray, shift: FloatArray) -> FloatArray:
    """Shift (n, 2) [px] of the right images of known points (n, 3) by the displacement of the camera."""
    right = (points[:, :2] - [calibration.baseline, 0.0]) / points[:, 2:]
    pixels = calibration.focal_length * right + [calibration.cx, calibration.cy]
    return _image_shift(calibration, pixels, 1.0 / points[:, 2], shift)


def _image_shift(
    calibration: StereoCalibration, right: Pixels, inverse_depth: FloatArray, shift: FloatArray
) -> FloatArray:
    """Shift (n, 2) [px] of calibrated right images (n, 2) with these inverse depths (n,) [1/m]."""
    f, c = calibration.focal_length, np.array([calibration.cx, calibration.cy])
    ahead = np.maximum(1.0 - inverse_depth * shift[2], _LEAST_AHEAD)
    moved: FloatArray = ((right - c) * shift[2] - f * shift[:2]) * (inverse_depth / ahead)[:, None]
    return moved
