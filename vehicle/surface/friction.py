"""Friction of tyre and ground that changes with position: by sides of a line, in patches, or from an image."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from vehicle.frames import FloatArray, dense, is_left

LOWEST, HIGHEST = 0.05, 1.5  # wet ice below 0 degC has some 0.05; racing tyres on dry asphalt 1.5 [-]
_SPACING = 0.1  # of the points that represent a line: at R = 10 m their error is s^2/8R = 0.1 mm [m]


@runtime_checkable  # pydantic checks tables that hold courses
class FrictionMap(Protocol):
    """Friction coefficient for every position."""

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Friction coefficient [-] at x, y [m] in W, all of one shape."""


Friction = float | FrictionMap


def friction_of(friction: Friction, x: ArrayLike, y: ArrayLike) -> FloatArray:
    """Friction coefficient [-] at x, y [m], of their common shape."""
    if isinstance(friction, int | float):
        return np.full(np.broadcast_shapes(np.shape(x), np.shape(y)), friction, dtype=np.float64)
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if x.shape != y.shape:
        x, y = np.broadcast_arrays(x, y)
    return friction.at(x, y)


class SplitFriction:
    """Different friction on either side of a line, such as a dry lane beside an icy one.

    Args:
        left: friction to the left of the line.
        right: friction to the right of it.
        line: points (n, 2) in W [m]; a road's centreline, or two points. It continues straight beyond both ends;
            where it bends or meets itself, its nearest point decides.
    """

    def __init__(self, left: Friction, right: Friction, line: FloatArray) -> None:
        self._left, self._right = left, right
        self._points = dense(line, _SPACING)[0]
        self._tree = scipy.spatial.cKDTree(self._points)

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Friction coefficient [-] at x, y [m] of one shape."""
        return np.where(self.is_left(x, y), friction_of(self._left, x, y), friction_of(self._right, x, y))

    def is_left(self, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
        """True for each position to the left of the line."""
        xy = np.stack([x, y], axis=-1)
        return is_left(self._points, np.asarray(self._tree.query(xy)[1], dtype=np.intp), xy)


class LineFriction:
    """Friction that changes along a line, such as a measured road; the nearest point of the line decides.

    Args:
        values: friction coefficients (n,) at the points.
        line: points (n, 2) in W [m].
    """

    def __init__(self, values: FloatArray, line: FloatArray) -> None:
        self._values, self._tree = values, scipy.spatial.cKDTree(line)

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Friction coefficient [-] at x, y [m] of one shape."""
        return self._values[self._tree.query(np.stack([x, y], axis=-1))[1]]


class FrictionImage:
    """Friction coefficients on a grid with linear interpolation; another friction outside of it.

    Args:
        values: (ny, nx) friction coefficients; the first row is the northernmost, as in an image.
        cell: side of a pixel [m].
        corner: W of the image's lower left corner [m].
        outside: friction beyond the image.
    """

    def __init__(self, values: FloatArray, *, cell: float, corner: tuple[float, float], outside: Friction) -> None:
        self._values = np.pad(np.asarray(values[::-1], dtype=np.float64), 1, mode="edge")
        self._cell, self._corner, self._outside = cell, corner, outside

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Friction coefficient [-] at x, y [m] of one shape."""
        ny, nx = np.array(self._values.shape) - 2
        u, v = (x - self._corner[0]) / self._cell, (y - self._corner[1]) / self._cell  # [px] from the corner
        inside = (u >= 0.0) & (u <= nx) & (v >= 0.0) & (v <= ny)
        value = _between(self._values, np.clip(u, 0.0, nx) + 0.5, np.clip(v, 0.0, ny) + 0.5)
        return np.where(inside, value, friction_of(self._outside, x, y))


def _between(values: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Bilinear interpolation of values[v, u]."""
    i, j = u.astype(np.intp), v.astype(np.intp)
    a, b = u - i, v - j
    lower = values[j, i] + a * (values[j, i + 1] - values[j, i])
    upper = values[j + 1, i] + a * (values[j + 1, i + 1] - values[j + 1, i])
    return lower + b * (upper - lower)


_SHARP = 1e-9  # width of a sharp edge; avoids division by zero [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionPatch:
    """Rectangle with rounded corners; without length and width it is a circle."""

    x: float  # W of the middle [m]
    y: float  # [m]
    friction: float
    heading: float = 0.0  # of its length [rad]
    half_length: float = 0.0  # of the rectangle to which the rounding is added [m]
    half_width: float = 0.0  # [m]
    rounding: float = 0.0  # radius of the circle [m]
    edge: float = 0.0  # width of the transition across the outline [m]


class PatchedFriction:
    """Patches on ground of another friction; where they overlap, the later one counts."""

    def __init__(self, base: Friction, patches: Sequence[FrictionPatch]) -> None:
        self._base = base
        self._centre = np.array([(p.x, p.y) for p in patches]).reshape(-1, 2)
        heading = np.array([p.heading for p in patches])
        self._cos, self._sin = np.cos(heading), np.sin(heading)
        self._half_length, self._half_width = (
            np.array([(p.half_length, p.half_width) for p in patches]).reshape(-1, 2).T
        )
        self._rounding = np.array([p.rounding for p in patches])
        self._edge = np.array([max(p.edge, _SHARP) for p in patches])
        self._friction = [p.friction for p in patches]

    def at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Friction coefficient [-] at x, y [m] of one shape."""
        share = np.clip(0.5 - (self._outside(x, y) - _SHARP) / self._edge, 0.0, 1.0)  # a sharp outline is inside
        friction = friction_of(self._base, x, y)
        for k, value in enumerate(self._friction):
            friction = (1.0 - share[..., k]) * friction + share[..., k] * value
        return friction

    def _outside(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Signed distance from the outline of each patch, negative inside, (..., n) [m]."""
        d_x, d_y = x[..., None] - self._centre[:, 0], y[..., None] - self._centre[:, 1]
        along = np.abs(self._cos * d_x + self._sin * d_y) - self._half_length
        across = np.abs(self._cos * d_y - self._sin * d_x) - self._half_width
        beyond = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
        outside: FloatArray = beyond + np.minimum(np.maximum(along, across), 0.0) - self._rounding
        return outside
