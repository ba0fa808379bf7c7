"""The straightest lines of an edge image, by Hough's transform."""

from __future__ import annotations

import math
from typing import Any, Final

import cv2
import numpy as np

from sensors.messages import GreyImage
from vehicle.frames import FloatArray

STEEPEST: Final = math.radians(30.0)  # a trace is within it: who slips more hardly gets on; lug marks lie across it
_ANGLE: Final = math.radians(1.0)  # bins of the transform; half of it gives no better lines
_DISTANCE: Final = 1.0  # [px]
_MOST: Final = 400  # strongest lines among which different ones are looked for
_APART: Final = 20.0  # of lines that are not the same one: two bins wide edges blur over [px]
_LEVER: Final = 300.0  # pixels of distance that one radian of direction counts for: half of an image's size [px/rad]


def strongest_lines(edges: GreyImage, n: int, least_votes: int) -> FloatArray:
    """Rows of rho [px], phi [rad] and votes of the n strongest lines that differ, strongest first; (m, 3), m <= n.

    A line is u cos(phi) + v sin(phi) = rho with phi in (-pi/2, pi/2]: 0 is a line straight up. Only lines within
    ``STEEPEST`` of that are looked for. One edge is a crowd of cells in the accumulator; only the strongest of them
    is taken.
    """
    # In the image turned over its diagonal these directions are one range, which OpenCV can be told.
    low, high = 0.5 * math.pi - STEEPEST, 0.5 * math.pi + STEEPEST
    turned = np.ascontiguousarray(edges.T)
    found: Any = cv2.HoughLinesWithAccumulator(turned, _DISTANCE, _ANGLE, least_votes, min_theta=low, max_theta=high)
    if found is None:  # OpenCV's types do not say that this is how it finds nothing
        return np.empty((0, 3))
    rho, theta, votes = found.reshape(-1, 3)[:_MOST].astype(np.float64).T
    return _different(np.column_stack([rho, 0.5 * math.pi - theta, votes]), n)


def upright(lines: FloatArray) -> FloatArray:
    """The same lines (n, 2 or more) with phi in (-pi/2, pi/2] and rho of either sign."""
    turned = lines.copy()
    over = np.where(turned[:, 1] > 0.5 * math.pi, 1, 0) - np.where(turned[:, 1] <= -0.5 * math.pi, 1, 0)
    turned[:, 1] -= math.pi * over
    turned[:, 0] = np.where(over != 0, -turned[:, 0], turned[:, 0])
    return turned


def _different(lines: FloatArray, n: int) -> FloatArray:
    """The first n lines none of which is close to an earlier one."""
    kept: list[FloatArray] = []
    while len(lines) and len(kept) < n:
        first = lines[0]
        kept.append(first)
        apart = np.abs(lines[:, 0] - first[0]) + _LEVER * np.abs(lines[:, 1] - first[1])
        lines = lines[apart > _APART]
    return np.array(kept).reshape(-1, 3)
