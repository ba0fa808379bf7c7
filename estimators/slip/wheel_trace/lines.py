"""Edges on the ground behind a wheel (Canny), and their strongest straight lines (Hough transform).

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.
"""

from __future__ import annotations

import math
from typing import Any, Final

import cv2
import numpy as np

from sensors.camera.lens import UNDISTORTED
from sensors.messages import GreyImage
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray, inverse

_LOW: Final = 1.0 / 3.0  # of the range of grey levels (eq. 3)
_HIGH: Final = 2.5  # of the low threshold (eq. 4)
_MARGIN: Final = 9  # around the wheel's image, which is blurred and shakes with the rover [px]; assumed
STEEPEST: Final = math.radians(30.0)  # largest angle of a trace; with more slip a rover hardly moves
_ANGLE: Final = math.radians(1.0)  # bin width; half of it gives no better lines
_DISTANCE: Final = 1.0  # [px]
_MOST: Final = 400  # strongest lines that are searched for distinct ones
_APART: Final = 20.0  # least distance of distinct lines: two bins that wide edges spread over [px]
_LEVER: Final = 300.0  # distance equivalent to one radian of direction: half of an image's size [px/rad]


class TraceEdges:
    """Canny edges of an undistorted image, without those of the wheel."""

    def __init__(self, rig: TraceRig) -> None:
        camera = rig.camera
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        rays = (np.stack([u, v], axis=-1) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        pixels = camera.pixels(rays).astype(np.float32)
        self._rig = rig
        self._maps = None
        if camera.distortion != UNDISTORTED:
            self._maps = cv2.convertMaps(pixels[..., 0], pixels[..., 1], cv2.CV_16SC2)

    def image(self, image: GreyImage) -> GreyImage:
        """Image without lens distortion, so that lines are straight."""
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def find(self, image: GreyImage, steer: float) -> GreyImage:
        """Edges of an undistorted image: 255, elsewhere 0; the wheel is steered by ``steer`` [rad], + left."""
        low, high = canny_thresholds(image)
        edges = cv2.Canny(image, low, high, apertureSize=3)
        return np.asarray(cv2.bitwise_and(edges, ground_mask(self._rig, steer)))


def strongest_lines(edges: GreyImage, n: int, least_votes: int) -> FloatArray:
    """Rows of rho [px], phi [rad] and votes of the n strongest distinct lines, strongest first; (m, 3), m <= n.

    A line is u cos(phi) + v sin(phi) = rho with phi in (-pi/2, pi/2]; phi = 0 is vertical. Only lines within
    ``STEEPEST`` of vertical are returned. One edge is a cluster of cells in the accumulator; the strongest is used.
    """
    # in the transposed image these directions are one interval, as OpenCV requires
    low, high = 0.5 * math.pi - STEEPEST, 0.5 * math.pi + STEEPEST
    turned = np.ascontiguousarray(edges.T)
    result: Any = cv2.HoughLinesWithAccumulator(turned, _DISTANCE, _ANGLE, least_votes, min_theta=low, max_theta=high)
    if result is None:  # no line found; missing in OpenCV's type stubs
        return np.empty((0, 3))
    rho, theta, votes = result.reshape(-1, 3)[:_MOST].astype(np.float64).T
    return _different(np.column_stack([rho, 0.5 * math.pi - theta, votes]), n)


def upright(lines: FloatArray) -> FloatArray:
    """Lines (n, 2 or more) normalised to phi in (-pi/2, pi/2], with rho of either sign."""
    turned = lines.copy()
    over = np.where(turned[:, 1] > 0.5 * math.pi, 1, 0) - np.where(turned[:, 1] <= -0.5 * math.pi, 1, 0)
    turned[:, 1] -= math.pi * over
    turned[:, 0] = np.where(over != 0, -turned[:, 0], turned[:, 0])
    return turned


def _different(lines: FloatArray, n: int) -> FloatArray:
    """First n lines that are not close to an earlier one."""
    kept: list[FloatArray] = []
    while len(lines) and len(kept) < n:
        first = lines[0]
        kept.append(first)
        apart = np.abs(lines[:, 0] - first[0]) + _LEVER * np.abs(lines[:, 1] - first[1])
        lines = lines[apart > _APART]
    return np.array(kept).reshape(-1, 3)


def canny_thresholds(image: GreyImage) -> tuple[float, float]:
    """Low and high threshold of the hysteresis, in units of the 3x3 Sobel kernel's sum (Reina 2008, eqs 3 and 4)."""
    low = _LOW * (float(image.max()) - float(image.min()))
    return low, _HIGH * low


def ground_mask(rig: TraceRig, steer: float) -> GreyImage:
    """Mask of an undistorted image: 255 for ground, 0 for the wheel."""
    turn = np.linspace(0.0, 2.0 * np.pi, 72)
    r, c, s = rig.wheel_radius, np.cos(steer), np.sin(steer)
    rim = np.stack([r * c * np.cos(turn), r * s * np.cos(turn), r + r * np.sin(turn)], axis=-1)
    across = 0.5 * rig.wheel_width * np.array([-s, c, 0.0])
    sides = np.concatenate([rim - across, rim + across]) + np.array([*rig.wheel, 0.0])
    hull = cv2.convexHull(np.round(_pinhole(rig, sides)).astype(np.int32))
    mask = np.full((rig.camera.height, rig.camera.width), 255, np.uint8)
    cv2.fillConvexPoly(mask, hull, 0)
    return np.asarray(cv2.erode(mask, np.ones((2 * _MARGIN + 1,) * 2, np.uint8)))


def _pinhole(rig: TraceRig, points: FloatArray) -> FloatArray:
    """Undistorted pixels (n, 2) of points (n, 3) in R; points behind the camera are moved in front of it."""
    X_CR = inverse(rig.X_RC)
    p_C = points @ X_CR[:3, :3].T + X_CR[:3, 3]
    depth = np.maximum(p_C[:, 2:], 0.05)
    pixels: FloatArray = p_C[:, :2] / depth * [rig.camera.fx, rig.camera.fy] + [rig.camera.cx, rig.camera.cy]
    limit = 4.0 * max(rig.camera.width, rig.camera.height)
    return np.clip(pixels, -limit, limit)
