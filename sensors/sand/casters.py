"""Shadows of the rover itself: of its body, its wheels, and a mast with a head that pans."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from sensors.sand.grid import Bytes, Floats
from sensors.sand.solids import WheelBody
from vehicle.clock import TICK
from vehicle.frames import FloatArray, cross, transform
from vehicle.rover.description import Rover
from vehicle.rover.truth import RoverTruth

_CELL: Final = 0.003  # of the map of shadows [m]
_SUN_DISC: Final = 0.0093  # angular diameter of the sun [rad]
_PAN: Final = (math.radians(60.0), 9.0)  # amplitude [rad] and period [s] of the mast's head; assumed
_METAL: Final = 0.45  # albedo of the wheels against that of sand: dull aluminium in the dust, assumed


@dataclass(frozen=True, slots=True, eq=False)
class Casters:
    """Parts of the rover that cast shadows, as convex clouds of points in R (n, 3) [m]."""

    fixed: tuple[FloatArray, ...]
    head: FloatArray | None  # of the mast, about its axis; None: no mast
    mast: FloatArray  # (3,) foot of the head on the mast's axis
    wheel: FloatArray  # (n, 3) about a wheel's lowest point, x along its heading
    radius: float  # of the wheels [m]
    width: float  # [m]
    lugs: int

    @classmethod
    def of(cls, rover: Rover, *, mast: bool, lugs: int) -> Casters:
        """Parts of a rover shaped like El Dorado II; dimensions missing in its file are assumed from photographs."""
        half, side = 0.5 * rover.wheelbase, 0.5 * rover.tread
        body = _box((-0.8 * half, 0.8 * half), (-0.62 * side, 0.62 * side), (0.26, 0.46))
        rockers = [_box((-half, half), (y - 0.02, y + 0.02), (0.22, 0.27)) for y in (-0.8 * side, 0.8 * side)]
        boom = _box((-half - 0.12, -0.7 * half), (side - 0.015, side + 0.015), (0.74, 0.77))  # carries the camera
        post = _box((-0.72 * half, -0.64 * half), (0.4 * side, 0.46 * side), (0.45, 0.76))
        pole = _box((0.3 * half - 0.02, 0.3 * half + 0.02), (-0.02, 0.02), (0.45, 1.05))
        angle = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
        rim = np.stack([rover.radius * np.cos(angle), 0.0 * angle, rover.radius * (1.0 + np.sin(angle))], axis=-1)
        wheel = np.concatenate([rim + np.array([0.0, side, 0.0]) for side in (-0.5 * rover.width, 0.5 * rover.width)])
        return cls(
            fixed=(body, *rockers, boom, post, *((pole,) if mast else ())),
            head=_box((-0.05, 0.07), (-0.16, 0.16), (0.0, 0.11)) if mast else None,
            mast=np.array([0.3 * half, 0.0, 1.05]),
            wheel=wheel,
            radius=rover.radius,
            width=rover.width,
            lugs=lugs,
        )

    def shadows(self, truth: RoverTruth, sun: FloatArray, x: Floats, y: Floats, z: Floats) -> Floats:
        """Share of the sun's light that reaches points of W (h, w) [m] past the rover.

        Shadows are drawn on a level plane; points are projected onto it along the sun's rays.
        """
        level = float(z.mean())
        lean = sun[:2] / max(float(sun[2]), 1e-3)  # horizontal distance of a ray per metre of rise
        above = z - np.float32(level)
        px, py = x - above * np.float32(lean[0]), y - above * np.float32(lean[1])
        low = np.array([px.min(), py.min()], dtype=float) - _CELL
        size = [math.ceil((float(p.max()) - start) / _CELL) + 2 for p, start in ((px, low[0]), (py, low[1]))]
        lit = self._shadow_map(truth, level, lean, low, (size[1], size[0]))
        u, v = (px - np.float32(low[0])) * np.float32(1.0 / _CELL), (py - np.float32(low[1])) * np.float32(1.0 / _CELL)
        share = cv2.remap(lit, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(share, dtype=np.float32) * np.float32(1.0 / 255.0)

    def wheel_body(self, truth: RoverTruth, k: int) -> WheelBody:
        """Visible body of a wheel."""
        up = truth.X_WB[:3, 2]
        ahead = np.array([math.cos(truth.wheel_headings[k]), math.sin(truth.wheel_headings[k]), 0.0])
        ahead -= (ahead @ up) * up
        ahead /= np.linalg.norm(ahead)
        X_WK = transform(np.column_stack([ahead, cross(up, ahead), up]), truth.wheel_positions[k] + self.radius * up)
        turned = float(truth.wheel_turns[k])
        return WheelBody(X_WK=X_WK, radius=self.radius, width=self.width, lugs=self.lugs, turned=turned, albedo=_METAL)

    def _shadow_map(
        self, truth: RoverTruth, level: float, lean: FloatArray, low: FloatArray, size: tuple[int, int]
    ) -> Bytes:
        """Map (rows, columns) of the remaining sun from the corner ``low`` on; high parts cast softer edges."""
        near, far = np.full(size, 255, np.uint8), np.full(size, 255, np.uint8)
        for cloud in self._clouds(truth):
            above = cloud[:, 2] - level
            cells = (cloud[:, :2] - above[:, None] * lean - low) / _CELL
            hull = cv2.convexHull(cells.astype(np.float32)).reshape(-1, 2)
            if (hull.max(axis=0) < 0.0).any() or (hull.min(axis=0) > size[::-1]).any():
                continue
            target = far if above.mean() > 0.5 else near
            cv2.fillConvexPoly(target, np.round(hull * 16.0).astype(np.int32), (0.0,), cv2.LINE_AA, 4)
        blurred = (
            cv2.GaussianBlur(layer, (0, 0), max(0.5 * _SUN_DISC * height / _CELL, 0.6))
            for layer, height in ((near, 0.4), (far, 1.2))
        )
        return np.asarray(np.minimum(*blurred), dtype=np.uint8)

    def _clouds(self, truth: RoverTruth) -> list[FloatArray]:
        """Point clouds of all parts in W."""
        R, p = truth.X_WB[:3, :3], truth.X_WB[:3, 3]
        clouds = [part @ R.T + p for part in self.fixed]
        if self.head is not None:
            amplitude, period = _PAN
            turn = amplitude * math.sin(2.0 * math.pi * truth.tick * TICK / period)
            clouds.append((self.head @ _about_z(turn).T + self.mast) @ R.T + p)
        for place, heading in zip(truth.wheel_positions, truth.wheel_headings, strict=True):
            clouds.append(self.wheel @ _about_z(float(heading)).T + place)
        return clouds


def _about_z(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> FloatArray:
    """Corners (8, 3)."""
    return np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)
