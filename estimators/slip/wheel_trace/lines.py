"""Strongest straight lines of an edge image, by the Hough transform."""

from __future__ import annotations

import math
from typing import Any, Final

import cv2
import numpy as np

from sensors.messages import GreyImage
from vehicle.frames import FloatArray

STEEPEST: Final = math.radians(30.0)  # largest angle of a trace; with more slip a rover hardly moves
_ANGLE: Final = math.radians(1.0)  # bin width; half of it gives no better lines
_DISTANCE: Final = 1.0  # [px]
_MOST: Final = 400  # strongest lines that are searched for distinct ones
_APART: Final = 20.0  # least distance of distinct lines: two bins that wide edges spread over [px]
_LEVER: Final = 300.0  # distance equivalent to one radian of direction: half of an image's size [px/rad]


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
