"""What a pinhole with a lens sees of a field of sand: its rays are followed to the relief, ruts and all.

Rays of every second pixel are followed and the others taken from between them: a ray more would change what is seen by
less than the relief within two pixels, some tenths of a millimetre.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.lens import CameraModel
from sensors.sand.grid import TEXEL, Floats, Window, window_around
from sensors.sand.light import came_back
from sensors.sand.solids import Hits
from sensors.sand.world import SandWorld
from vehicle.frames import FloatArray, inverse

_STEPS: Final = 3  # towards the relief: each leaves the slope times the tangent of the view of what was left before
_AROUND: Final = 0.05  # of the ground that plane geometry says is seen [m]
_BORDER: Final = 4  # pixels around the image that are followed, too
_LEAST_FALL: Final = 0.05  # of a ray towards the ground, over its length along the optical axis


class Body(Protocol):
    """Whatever stands on the ground, such as ``sensors.sand.solids.Ellipsoid``."""

    @property
    def reach(self) -> float:
        """Radius around its middle that has all of it [m]."""
        ...

    def hit(self, eye: FloatArray, rays: Floats, sun: FloatArray) -> Hits:
        """Where rays (..., 3) from an eye meet it."""
        ...


class Seen(NamedTuple):
    """What each pixel of an image sees of the ground."""

    window: Window
    u: Floats  # (h, w) column and row in the window [texels]
    v: Floats
    x: Floats  # (h / 2, w / 2) in W, of each fourth pixel with some around the image [m]
    y: Floats
    z: Floats


@dataclass(frozen=True, slots=True, eq=False)
class GroundView:
    """Follows the rays of one camera."""

    camera: CameraModel
    rays: Floats  # (h, w, 2) x and y at depth 1 of each pixel
    between: Floats  # (h / 2 + .., w / 2 + .., 2) the same between four pixels each, and beyond the image's edge

    @classmethod
    def of(cls, camera: CameraModel) -> GroundView:
        """Of all pixels of a camera."""
        v, u = np.mgrid[0.0 : camera.height, 0.0 : camera.width]
        row = np.arange(0.5 - _BORDER, camera.height + _BORDER - 1, 2.0)
        column = np.arange(0.5 - _BORDER, camera.width + _BORDER - 1, 2.0)
        at = np.stack(np.meshgrid(column, row), axis=-1)
        return cls(
            camera,
            camera.rays(np.stack([u, v], axis=-1)).astype(np.float32),
            camera.rays(at).astype(np.float32),
        )

    def full(self, half: Floats) -> Floats:
        """An image for all pixels from one for those between."""
        rows, columns = self.rays.shape[:2]
        wide = cv2.resize(half, (2 * half.shape[1], 2 * half.shape[0]), interpolation=cv2.INTER_LINEAR)
        return np.asarray(wide[_BORDER : _BORDER + rows, _BORDER : _BORDER + columns], dtype=np.float32)

    def footprint(self, X_WC: FloatArray, world: SandWorld) -> FloatArray:
        """Where the rays of the image's edge meet the ground if it is plane (n, 2) [m].

        Raises:
            ValueError: if the camera is below the ground or does not look down at it.
        """
        b = self.between
        edge = np.concatenate([b[0, ::16], b[-1, ::16], b[::16, 0], b[::16, -1], b[-1, -1:]]).astype(float)
        rays = edge @ X_WC[:3, :2].T + X_WC[:3, 2]
        eye = X_WC[:3, 3]
        a, bx, by = _plane(world, eye)
        fall = bx * rays[:, 0] + by * rays[:, 1] - rays[:, 2]
        above = eye[2] - (a + bx * eye[0] + by * eye[1])
        if above <= 0.0 or fall.min() < _LEAST_FALL:
            raise ValueError(f"the trace camera is {above:.2f} m above the ground and must look down at it")
        return np.asarray(eye[:2] + (above / fall)[:, None] * rays[:, :2])

    def look(self, X_WC: FloatArray, world: SandWorld) -> Seen:
        """What is seen from X_WC (4, 4)."""
        window = window_around(self.footprint(X_WC, world), _AROUND)
        height, eye, corner = world.height(window), X_WC[:3, 3], window.corner
        rx, ry, rz = _turned(self.between, X_WC)
        kx, ky = rx / rz, ry / rz  # how far a ray goes along x and y for each metre that it rises
        a, bx, by = _plane(world, eye)
        below = a + bx * eye[0] + by * eye[1] - eye[2]  # the plane under the eye [m]
        down = np.asarray(below / (1.0 - np.float32(bx) * kx - np.float32(by) * ky), dtype=np.float32)
        ex, ey = ((eye[:2] - corner) / TEXEL).astype(np.float32)
        kx, ky = kx * np.float32(1.0 / TEXEL), ky * np.float32(1.0 / TEXEL)
        for _ in range(_STEPS):
            down = np.asarray(_looked_up(height, ex + kx * down, ey + ky * down) - eye[2], dtype=np.float32)
        u, v = ex + kx * down, ey + ky * down
        x, y = u * np.float32(TEXEL) + np.float32(corner[0]), v * np.float32(TEXEL) + np.float32(corner[1])
        return Seen(window, self.full(u), self.full(v), x, y, np.asarray(down + np.float32(eye[2]), dtype=np.float32))

    def light(self, seen: Seen, world: SandWorld) -> tuple[Floats, Floats]:
        """Shares of the light of sun and sky that come back to every pixel from open ground."""
        lit = cv2.remap(world.lit(seen.window), seen.u, seen.v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return came_back(np.asarray(lit, dtype=np.uint8))

    def tint(self, seen: Seen, world: SandWorld) -> Floats:
        """How grey the ground is at every pixel, 0 to 1."""
        tint = _looked_up(world.tint(seen.window), seen.u, seen.v)
        return np.asarray(tint / 255.0, dtype=np.float32)

    def draw(
        self,
        bodies: Iterable[tuple[FloatArray, Body]],
        X_WC: FloatArray,
        seen: Seen,
        sun: FloatArray,
        direct: Floats,
        ambient: Floats,
    ) -> NDArray[np.bool_]:
        """Put bodies at places (3,) of W into the shares of light, as far as they are in view and above the ground.

        Returns:
            Which pixels they hide the ground from.
        """
        z, hidden = self.full(seen.z), np.zeros(direct.shape, dtype=bool)
        for place, body in bodies:
            part = self._part(X_WC, place, body.reach)
            if part is None:
                continue
            rays = np.stack(_turned(self.rays[part], X_WC), axis=-1)
            hits = body.hit(X_WC[:3, 3], rays, sun)
            ground = (z[part][hits.met] - np.float32(X_WC[2, 3])) / rays[..., 2][hits.met]
            first = hits.depth < ground
            shown = hits.met
            shown[hits.met] = first
            direct[part][shown] = 0.5 * (hits.facing * hits.albedo)[first]
            ambient[part][shown] = 0.5 * (hits.sky * hits.albedo)[first]
            hidden[part] |= shown
        return hidden

    def _part(self, X_WC: FloatArray, place: FloatArray, reach: float) -> tuple[slice, slice] | None:
        """Rows and columns that show what is so near to a place; None if none do."""
        middle = inverse(X_WC) @ np.append(place, 1.0)
        if middle[2] < 2.0 * reach:
            return None  # nothing that near is meant to be seen
        u, v = self.camera.project(middle[None, :3])[0]
        size = 1.3 * reach * max(self.camera.fx, self.camera.fy) / (middle[2] - reach)
        rows = slice(max(0, int(v - size)), min(self.camera.height, int(v + size) + 1))
        columns = slice(max(0, int(u - size)), min(self.camera.width, int(u + size) + 1))
        return None if rows.stop <= rows.start or columns.stop <= columns.start else (rows, columns)


def _turned(rays: Floats, X_WC: FloatArray) -> tuple[Floats, Floats, Floats]:
    """Components in W of rays (..., 2) of depth 1."""
    R = X_WC[:3, :3].astype(np.float32)
    x, y = rays[..., 0], rays[..., 1]
    along = [R[k, 0] * x + R[k, 1] * y + R[k, 2] for k in range(3)]
    return along[0], along[1], along[2]


def _looked_up(layer: Floats | NDArray[np.uint8], u: Floats, v: Floats) -> Floats:
    found = cv2.remap(layer, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.float32)


def _plane(world: SandWorld, place: FloatArray) -> tuple[float, float, float]:
    """Height a + bx x + by y of the plane that the large shape is like below a place."""
    x, y = place[:2].tolist()
    bx, by = np.asarray(world.terrain.gradient(x, y)).reshape(2).tolist()
    return float(world.terrain.height(x, y)) - bx * x - by * y, bx, by
