"""Lines behind a wheel, in the image and on the ground, and the confidence that they are its trace.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008.

A line in the image is P = (rho, phi), see ``lines``. On the ground it is R = (d, theta): its distance from the centre
of mass G, assumed at R's origin, + left, and the wheel's direction of travel along it relative to R's x axis, + left.
Y is its lateral offset from the wheel's centre B on the axle's line, + left.

Every input is an absolute difference with a degree of membership in "small" and "large". The membership functions are
triangles (Fig. 5); the paper gives no numbers for their breakpoints. They are chosen here by the meaning of the inputs,
see ``Breakpoints``. The rules are of Mamdani type: the strength of a rule is the minimum of its conditions, and rules
with the same conclusion combine by the maximum. Defuzzification is by the height method (mean of the peaks, weighted
with the strengths): with centroids of triangles no confidence could be as low as the 1.1 % of Table II. If no rule
applies the confidence is 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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


# Conditions S(mall) and L(arge) on rho, phi, d, theta, Y, and the peak of the conclusion (Reina 2008, Table I).
LOW, MEDIUM, HIGH = 0.0, 0.5, 1.0
RULES: Final = (
    ("SSSSS", HIGH),
    ("SLSLS", MEDIUM),
    ("LSLSL", LOW),
    ("LLLLL", LOW),
    ("LLSSL", LOW),
    ("SSLLS", MEDIUM),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Breakpoints:
    """Differences at which the membership in "small" reaches 0, from 1 at 0; "large" is the complement.

    Image and ground describe the same line, so their breakpoints correspond. A direction may differ by the largest
    slip between two detections of the trace with a loss in between (16 deg is about the largest slip of a rover that
    still moves; from image to image it is at most 2 deg). A position may differ by the resulting offset in the middle
    of the view. At the wheel's centre a line must pass within a third of the wheel's width: the nearest line that can
    be mistaken for the trace is the front wheel's rut, 0.05 m beside that of the rear wheel at a slip of 5 deg.

    Raises:
        ValueError: if one is not positive.
    """

    rho: float  # [px]
    phi: float  # [rad]
    d: float  # [m]
    theta: float  # [rad]
    Y: float  # [m]

    def __post_init__(self) -> None:
        for name in ("rho", "phi", "d", "theta", "Y"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"breakpoint {name} = {getattr(self, name)} must be positive")

    def scaled(self, factor: float) -> Breakpoints:
        """Breakpoints times a factor."""
        return Breakpoints(
            rho=factor * self.rho,
            phi=factor * self.phi,
            d=factor * self.d,
            theta=factor * self.theta,
            Y=factor * self.Y,
        )

    def as_array(self) -> FloatArray:
        """Array (5,) in the order of the rules' conditions."""
        return np.array([self.rho, self.phi, self.d, self.theta, self.Y])


def small(differences: FloatArray, breakpoints: Breakpoints) -> FloatArray:
    """Membership (n, 5) of differences (n, 5) in "small": triangles with their peak at 0."""
    degree: FloatArray = np.clip(1.0 - differences / breakpoints.as_array(), 0.0, 1.0)
    return degree


def confidence(differences: FloatArray, breakpoints: Breakpoints) -> FloatArray:
    """Confidence (n,), 0 to 1, of candidates with differences (n, 5) in rho, phi, d, theta and Y."""
    s = small(differences, breakpoints)
    strength = {HIGH: np.zeros(len(s)), MEDIUM: np.zeros(len(s)), LOW: np.zeros(len(s))}
    for conditions, conclusion in RULES:
        chosen = np.where(np.array(list(conditions)) == "S", s, 1.0 - s)
        strength[conclusion] = np.maximum(strength[conclusion], chosen.min(axis=1))
    total = sum(strength.values())
    pulled = sum(peak * degree for peak, degree in strength.items())
    result: FloatArray = pulled / np.maximum(total, 1e-12)
    return result
