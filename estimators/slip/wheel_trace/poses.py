"""Lines behind a wheel in the image and on the ground (Reina 2008, section II-A.1, Figs 3 and 4).

A line in the image is P = (rho, phi), see ``lines``. On the ground it is R = (d, theta): its distance from the centre
of mass G, assumed at R's origin, + left, and the wheel's direction of travel along it relative to R's x axis, + left.
Y is its lateral offset from the wheel's centre B on the axle's line, + left.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.slip.wheel_trace.lines import upright
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_ACROSS: Final = 1e-9  # of a unit normal: lines straight across the rover have no offset Y


class GroundLines:
    """Map lines between image and ground, for level ground and the calibrated attitude of the rover."""

    def __init__(self, rig: TraceRig) -> None:
        self._wheel = rig.wheel
        self._H = rig.image_of_ground()
        self._G = np.linalg.inv(self._H)

    def visible(self) -> float:
        """Length of visible ground straight behind the wheel's centre [m]."""
        u, _, w = self._H @ [*self._wheel, 1.0]
        x, _, size = self._G @ [u / w, 0.0, 1.0]
        return float(self._wheel[0] - x / size)

    def ground(self, lines: FloatArray) -> FloatArray:
        """Rows d [m], theta [rad], Y [m] on the ground of image lines, given as rows of rho [px], phi [rad], ..."""
        rho, phi = lines[:, 0], lines[:, 1]
        a, b, c = (np.column_stack([np.cos(phi), np.sin(phi), -rho]) @ self._H).T  # a x + b y + c = 0 in R
        size = np.hypot(a, b) * np.where(b < 0.0, -1.0, 1.0)
        a, b, c = a / size, b / size, c / size  # the normal points to the left
        theta = np.arctan2(-a, b)
        x, y = self._wheel
        offset = -(a * x + c) / np.where(b > _ACROSS, b, _ACROSS) - y
        return np.column_stack([-c, theta, offset])

    def image(self, theta: FloatArray, offset: FloatArray) -> FloatArray:
        """Rows rho [px], phi [rad] of lines on the ground with direction theta [rad] and offset Y from B [m]."""
        x, y = self._wheel
        normal = np.column_stack([-np.sin(theta), np.cos(theta)])
        c = np.sin(theta) * x - np.cos(theta) * (y + offset)
        l_u, l_v, l_w = (np.column_stack([normal, c]) @ self._G).T
        size = np.hypot(l_u, l_v)
        return upright(np.column_stack([-l_w / size, np.arctan2(l_v, l_u)]))


def turn_between(a: FloatArray, b: float) -> FloatArray:
    """Absolute angle between undirected lines [rad], 0 to pi/2."""
    turn: FloatArray = np.abs((a - b + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
    return turn
