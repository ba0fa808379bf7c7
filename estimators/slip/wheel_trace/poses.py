"""Lines behind a wheel in the image and on the ground (Reina 2008, section II-A.1, Figs 3 and 4).

A line in the image is P = (rho, phi), see ``lines``. On the ground it is R = (d, theta): its distance from the centre
of mass G, taken at R's origin, + left of it, and the direction in which the wheel came along it, against R's x axis,
+ left. Y is where it crosses the axle's line, to the left of the wheel's centre B.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.slip.wheel_trace.lines import upright
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_ACROSS: Final = 1e-9  # of a unit normal: lines straight across the rover have no place beside the wheel


class GroundLines:
    """Lines from image to ground and back; the ground is level and the rover stands on it as it was calibrated."""

    def __init__(self, rig: TraceRig) -> None:
        self._wheel = rig.wheel
        self._H = rig.image_of_ground()
        self._G = np.linalg.inv(self._H)

    def visible(self) -> float:
        """How far behind the wheel's centre the ground straight behind it is seen [m]."""
        u, _, w = self._H @ [*self._wheel, 1.0]
        x, _, size = self._G @ [u / w, 0.0, 1.0]
        return float(self._wheel[0] - x / size)

    def ground(self, lines: FloatArray) -> FloatArray:
        """Rows d [m], theta [rad], Y [m] of lines in the image, rows of rho [px] and phi [rad] first."""
        rho, phi = lines[:, 0], lines[:, 1]
        a, b, c = (np.column_stack([np.cos(phi), np.sin(phi), -rho]) @ self._H).T  # a x + b y + c = 0 in R
        size = np.hypot(a, b) * np.where(b < 0.0, -1.0, 1.0)
        a, b, c = a / size, b / size, c / size  # the normal points to the left
        theta = np.arctan2(-a, b)
        x, y = self._wheel
        beside = -(a * x + c) / np.where(b > _ACROSS, b, _ACROSS) - y
        return np.column_stack([-c, theta, beside])

    def image(self, theta: FloatArray, beside: FloatArray) -> FloatArray:
        """Rows rho [px], phi [rad] of lines on the ground with direction theta [rad], that pass Y beside B [m]."""
        x, y = self._wheel
        normal = np.column_stack([-np.sin(theta), np.cos(theta)])
        c = np.sin(theta) * x - np.cos(theta) * (y + beside)
        l_u, l_v, l_w = (np.column_stack([normal, c]) @ self._G).T
        size = np.hypot(l_u, l_v)
        return upright(np.column_stack([-l_w / size, np.arctan2(l_v, l_u)]))


def turn_between(a: FloatArray, b: float) -> FloatArray:
    """Absolute angle between undirected lines [rad], 0 to pi/2."""
    turn: FloatArray = np.abs((a - b + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
    return turn
