"""Planar range scanner at the rear of a trailer: an example of a sensor of one's own.

``--set sensor=range_scanner:RangeScanner`` names it when this folder is the working directory or on ``PYTHONPATH``.

Ranges come from rendered depth: two cameras of a single row of pixels look half to the rear and to either side. Not
modelled: the time that a scan takes, beam divergence, surfaces that reflect too little, the trailer's own body.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol, Self

import numpy as np

from sensors.camera.rig import StereoCalibration
from vehicle.combination.truth import Truth
from vehicle.frames import R_BODY_CAMERA, FloatArray, rotation_zyx, transform

if TYPE_CHECKING:
    from sensors.context import TrailerSensorContext

NOISE: Final = 0.02  # standard deviation of a range; assumed, as of a scanner for outdoor vehicles [m]
RANGE: Final = 40.0  # greatest; farther away the beams of a rolling trailer reach the ground [m]
_HEIGHT: Final = 1.2  # above the ground: over kerbs, below the tops of hedges [m]
_STEP: Final = math.radians(0.25)  # between beams, nearly
_COLUMNS: Final = 2048  # of a camera's row [px]
_HALF_FIELD: Final = math.radians(60.0)  # half the field of view of a camera
_YAWS: Final = (math.radians(120.0), math.radians(-120.0))  # of the cameras; together they see 240 deg to the rear


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RangeScan:
    """One scan; beams start at the scanner and lie in the xy plane of its frame, which is parallel to the trailer's."""

    tick: int
    bearings: FloatArray  # (n,) of the beams, from the x axis, + left [rad]
    ranges: FloatArray  # (n,) [m]; infinite where nothing is within RANGE


class DepthSource(Protocol):
    """Renderer of depth images, such as ``sensors.render.StereoRenderer``."""

    def render_depth_from(self, X_WC1: FloatArray, X_WC2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Depth along the optical axis [m] of two cameras, (height, width) each."""


class RangeScanner:
    """Samples the scan from one unit of a combination."""

    def __init__(self, renderer: DepthSource, *, unit: int, x: float, rng: np.random.Generator) -> None:
        """Scanner on the axis of a ``unit``, ``x`` [m] from its frame's origin, negative behind it."""
        self.x = x
        self._renderer, self._unit, self._rng = renderer, unit, rng
        c = row_camera(x)
        wanted = np.arange(-_HALF_FIELD + 0.5 * _STEP, _HALF_FIELD, _STEP)
        self._columns = np.rint(c.cx - c.focal_length * np.tan(wanted)).astype(int)
        tangents = (self._columns - c.cx) / c.focal_length
        self._stretch = np.hypot(1.0, tangents)  # range over depth
        self._bearings = np.concatenate([yaw - np.arctan(tangents) for yaw in _YAWS])
        self._mounts = [transform(rotation_zyx(yaw, 0.0, 0.0) @ R_BODY_CAMERA, c.X_SC[:3, 3]) for yaw in _YAWS]

    @classmethod
    def of(cls, context: TrailerSensorContext) -> Self:
        """Scanner at the rear end of the context's unit."""
        x = context.vehicle.units[context.unit].rear_x
        return cls(context.views.seen_by(row_camera(x)), unit=context.unit, x=x, rng=context.rng)

    def sample(self, truth: Truth) -> RangeScan:
        """Scan at the truth's tick."""
        X_WB = truth.bodies[self._unit]
        first, second = (X_WB @ X_SC for X_SC in self._mounts)
        depths = self._renderer.render_depth_from(first, second)
        exact = np.concatenate([depth[0, self._columns] * self._stretch for depth in depths])
        ranges = exact + NOISE * self._rng.standard_normal(len(exact))
        return RangeScan(tick=truth.tick, bearings=self._bearings, ranges=np.where(ranges < RANGE, ranges, np.inf))


def row_camera(x: float) -> StereoCalibration:
    """Camera with a single row of pixels, ``x`` [m] from the hitch; its row lies in the scan's plane."""
    return StereoCalibration(
        width=_COLUMNS,
        height=1,
        focal_length=0.5 * _COLUMNS / math.tan(_HALF_FIELD),
        cx=0.5 * (_COLUMNS - 1),
        cy=0.0,
        baseline=1.0,  # a renderer asks for one; the cameras' places are given with each scan
        X_SC=transform(R_BODY_CAMERA, np.array([x, 0.0, _HEIGHT])),
    )
