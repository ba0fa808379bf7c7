"""Patches of another friction on the ground: a sheet of ice, a puddle, a spill."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vehicle.frames import FloatArray
from vehicle.surface.friction import Friction, check_friction, friction_of

_SHARP = 1e-9  # width of a sharp edge; avoids division by zero [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch:
    """Rectangle with rounded corners; build one with ``circle`` or ``rectangle``."""

    x: float  # W of the middle [m]
    y: float  # [m]
    heading: float  # of its length [rad]
    half_length: float  # of the rectangle to which the rounding is added [m]
    half_width: float  # [m]
    rounding: float  # [m]
    friction: float
    edge: float  # width of the transition across the outline [m]

    def __post_init__(self) -> None:
        check_friction("friction", self.friction)
        if self.edge < 0.0:
            raise ValueError(f"edge = {self.edge} m must not be negative")


def circle(x: float, y: float, radius: float, friction: float, edge: float = 0.0) -> Patch:
    """A round patch about x, y [m].

    Raises:
        ValueError: naming the value that is out of range.
    """
    if not radius > 0.0:
        raise ValueError(f"radius = {radius} m must be positive")
    return Patch(x=x, y=y, heading=0.0, half_length=0.0, half_width=0.0, rounding=radius, friction=friction, edge=edge)


def rectangle(
    x: float, y: float, length: float, width: float, friction: float, heading: float = 0.0, edge: float = 0.0
) -> Patch:
    """A rectangular patch about x, y [m], its length along ``heading`` [rad].

    Raises:
        ValueError: naming the value that is out of range.
    """
    for name, side in (("length", length), ("width", width)):
        if not side > 0.0:
            raise ValueError(f"{name} = {side} m must be positive")
    half_length, half_width = 0.5 * length, 0.5 * width
    return Patch(
        x=x,
        y=y,
        heading=heading,
        half_length=half_length,
        half_width=half_width,
        rounding=0.0,
        friction=friction,
        edge=edge,
    )


class PatchedFriction:
    """Patches on ground of another friction; where they overlap, the later one counts."""

    def __init__(self, base: Friction, patches: Sequence[Patch]) -> None:
        check_friction("base", base)
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
