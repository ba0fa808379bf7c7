"""Rocks beside the path, and their shadows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from sensors.sand.grid import TEXEL, Floats, Window
from sensors.sand.solids import Ellipsoid
from vehicle.frames import FloatArray, rotation_zyx, transform
from vehicle.rover.terrain import Terrain

_NEAREST: Final = 0.45  # from a rock's edge to the path: half a rover's width and a margin [m]
_FARTHEST: Final = 1.2  # beyond it neither a rock nor its shadow is seen [m]
_SIZES: Final = (0.05, 0.16)  # half length of a rock [m]
_PENUMBRA: Final = 0.12  # share of a rock's radius over which its shadow fades, as its outline is rough; assumed


@dataclass(frozen=True, slots=True)
class Rock:
    """Half-buried ellipsoid."""

    place: tuple[float, float, float]  # of its middle in W [m]
    turn: float  # yaw of its longest axis in W [rad]
    radii: tuple[float, float, float]  # [m]
    albedo: float  # relative to sand

    def light(self, window: Window, height: Floats, sun: FloatArray) -> Floats | None:
        """Share of the sun's light (direction (3,)) on ground of a height in W [m]; None: all of it."""
        shadow = self.radii[2] / max(float(sun[2]), 0.05) + max(self.radii)  # largest possible length [m]
        corner, size = window.corner, TEXEL * np.array(window.shape[::-1])
        nearest = np.clip(self.place[:2], corner, corner + size)
        if math.dist(nearest, self.place[:2]) > shadow:
            return None
        c, s = math.cos(self.turn), math.sin(self.turn)
        ray = np.array([c * sun[0] + s * sun[1], c * sun[1] - s * sun[0], sun[2]]) / self.radii
        ray /= np.linalg.norm(ray)
        x, y = window.places()
        dx, dy = x + np.float32(corner[0] - self.place[0]), y + np.float32(corner[1] - self.place[1])
        u, v = (dx * c + dy * s) / self.radii[0], (dy * c - dx * s) / self.radii[1]
        w = (height - np.float32(self.place[2])) / np.float32(self.radii[2])
        ahead = -(u * ray[0] + v * ray[1] + w * ray[2])  # along the ray to its nearest point to the middle
        distance = np.sqrt(np.maximum(u * u + v * v + w * w - ahead * ahead, 0.0))
        clear = np.clip((distance - 1.0) / _PENUMBRA + 0.5, 0.0, 1.0)
        return np.asarray(np.where(ahead > 0.0, clear, 1.0), dtype=np.float32)

    def body(self) -> Ellipsoid:
        """Visible body."""
        X_WE = transform(rotation_zyx(self.turn, 0.0, 0.0), np.array(self.place))
        return Ellipsoid(X_WE=X_WE, radii=self.radii, albedo=self.albedo)


def scattered(rng: np.random.Generator, density: float, route: FloatArray, terrain: Terrain) -> tuple[Rock, ...]:
    """Scatter rocks on both sides of a route (n, 2); the route stays free."""
    low, high = route.min(axis=0) - _FARTHEST, route.max(axis=0) + _FARTHEST
    rocks: list[Rock] = []
    for _ in range(rng.poisson(density * float(np.prod(high - low)))):
        (x, y), size = rng.uniform(low, high).tolist(), rng.uniform(*_SIZES)
        radii = (size, size * rng.uniform(0.6, 0.95), size * rng.uniform(0.6, 1.3))
        turn, albedo = rng.uniform(0.0, math.pi), rng.uniform(0.5, 0.85)
        distance = float(np.hypot(*(route - [x, y]).T).min())
        free = all(math.dist((x, y), rock.place[:2]) > 0.8 * (size + rock.radii[0]) for rock in rocks)
        if free and _NEAREST + size < distance < _FARTHEST:
            rocks.append(Rock((x, y, float(terrain.height(x, y))), turn, radii, albedo))
    return tuple(rocks)
