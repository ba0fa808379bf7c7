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

from sensors.camera.lens import CameraModel
from sensors.sand.grid import TEXEL, Floats, Window, window_around
from sensors.sand.light import came_back
from sensors.sand.solids import Hits
from sensors.sand.world import SandWorld
from vehicle.frames import FloatArray

_STEPS: Final = 3  # towards the relief: each leaves the slope times the tangent of the view of what was left before
_AROUND: Final = 0.05  # of the ground that plane geometry says is seen [m]
_BORDER: Final = 4  # pixels around the image that are followed, too
_NEAREST: Final = 0.1  # that a body may be to the camera, along its axis [m]
_BOWED: Final = 6  # how far a lens bends the straight edge of a body at most [px]
_LEAST_FALL: Final = 0.05  # of a ray towards the ground, over its length along the optical axis


class Body(Protocol):
    """Whatever stands on the ground, such as ``sensors.sand.solids.Ellipsoid``."""

    @property
    def corners(self) -> FloatArray:
        """Of a box (8, 3) in W that has all of it [m]."""
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
    rays: Floats  # (2, h, w) x and y at depth 1 of each pixel
    between: Floats  # (2, h / 2 + .., w / 2 + ..) the same between four pixels each, and beyond the image's edge

    @classmethod
    def of(cls, camera: CameraModel) -> GroundView:
        """Of all pixels of a camera."""
        v, u = np.mgrid[0.0 : camera.height, 0.0 : camera.width]
        row = np.arange(0.5 - _BORDER, camera.height + _BORDER - 1, 2.0)
        column = np.arange(0.5 - _BORDER, camera.width + _BORDER - 1, 2.0)
        pixels = np.stack([u, v], axis=-1), np.stack(np.meshgrid(column, row), axis=-1)
        rays, between = (np.ascontiguousarray(np.moveaxis(camera.rays(at), -1, 0), dtype=np.float32) for at in pixels)
        return cls(camera, rays, between)

    def full(self, half: Floats) -> Floats:
        """An image for all pixels from one for those between."""
        rows, columns = self.rays.shape[1:]
        wide = cv2.resize(half, (2 * half.shape[1], 2 * half.shape[0]), interpolation=cv2.INTER_LINEAR)
        return np.asarray(wide[_BORDER : _BORDER + rows, _BORDER : _BORDER + columns], dtype=np.float32)

    def footprint(self, X_WC: FloatArray, world: SandWorld) -> FloatArray:
        """Where the rays of the image's edge meet the ground if it is plane (n, 2) [m].

        Raises:
            ValueError: if the camera is below the ground or does not look down at it.
        """
        b = self.between
        edge = np.concatenate([b[:, 0, ::16], b[:, -1, ::16], b[:, ::16, 0], b[:, ::16, -1], b[:, -1, -1:]], axis=1)
        rays = edge.T.astype(float) @ X_WC[:3, :2].T + X_WC[:3, 2]
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
        below = np.float32(a + bx * eye[0] + by * eye[1] - eye[2])  # the plane under the eye [m]
        down: Floats = np.divide(below, 1.0 - np.float32(bx) * kx - np.float32(by) * ky, dtype=np.float32)
        ex, ey = ((eye[:2] - corner) / TEXEL).astype(np.float32)
        kx *= np.float32(1.0 / TEXEL)
        ky *= np.float32(1.0 / TEXEL)
        for _ in range(_STEPS):
            down = _looked_up(height, ex + kx * down, ey + ky * down) - np.float32(eye[2])
        u, v = ex + kx * down, ey + ky * down
        x, y = u * np.float32(TEXEL) + np.float32(corner[0]), v * np.float32(TEXEL) + np.float32(corner[1])
        return Seen(window, self.full(u), self.full(v), x, y, down + np.float32(eye[2]))

    def light(self, seen: Seen, world: SandWorld) -> tuple[Floats, Floats]:
        """Shares of the light of sun and sky that come back to every pixel from open ground."""
        direct, ambient = (came_back(_looked_up(plane, seen.u, seen.v)) for plane in world.lit(seen.window))
        return direct, ambient

    def tint(self, seen: Seen, world: SandWorld) -> Floats:
        """How grey the ground is at every pixel, 0 to 1."""
        tint = _looked_up(world.tint(seen.window), seen.u, seen.v)
        return np.asarray(tint / 255.0, dtype=np.float32)

    def draw(
        self,
        bodies: Iterable[Body],
        X_WC: FloatArray,
        seen: Seen,
        sun: FloatArray,
        direct: Floats,
        ambient: Floats,
    ) -> NDArray[np.bool_]:
        """Put bodies into the shares of light, as far as they are in view and above the ground.

        Returns:
            Which pixels they hide the ground from.
        """
        z, hidden = self.full(seen.z), np.zeros(direct.shape, dtype=bool)
        for body in bodies:
            part = self._part(X_WC, body.corners)
            if part is None:
                continue
            rays = np.stack(_turned(self.rays[:, *part], X_WC), axis=-1)
            hits = body.hit(X_WC[:3, 3], rays, sun)
            ground = (z[part][hits.met] - np.float32(X_WC[2, 3])) / rays[..., 2][hits.met]
            first = hits.depth < ground
            shown = hits.met
            shown[hits.met] = first
            direct[part][shown] = 0.5 * (hits.facing * hits.albedo)[first]
            ambient[part][shown] = 0.5 * (hits.sky * hits.albedo)[first]
            hidden[part] |= shown
        return hidden

    def _part(self, X_WC: FloatArray, corners: FloatArray) -> tuple[slice, slice] | None:
        """Rows and columns that show what lies between corners (n, 3) of W; None if none do."""
        p_C = (corners - X_WC[:3, 3]) @ X_WC[:3, :3]
        if p_C[:, 2].min() < _NEAREST:
            return None  # nothing that near is meant to be seen
        u, v = self.camera.project(p_C).T
        rows, columns = (
            slice(max(0, int(at.min()) - _BOWED), min(size, int(at.max()) + _BOWED + 1))
            for at, size in ((v, self.camera.height), (u, self.camera.width))
        )
        return None if rows.stop <= rows.start or columns.stop <= columns.start else (rows, columns)


def _turned(rays: Floats, X_WC: FloatArray) -> list[Floats]:
    """Components in W (x, y, z) of rays (2, ...) of depth 1."""
    x, y = rays
    turned = []
    for along_x, along_y, along_z in X_WC[:3, :3].astype(np.float32):
        along = along_x * x
        along += along_y * y
        along += along_z
        turned.append(along)
    return turned


def _looked_up(layer: Floats | NDArray[np.uint8], u: Floats, v: Floats) -> Floats:
    found = cv2.remap(layer, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.float32)


def _plane(world: SandWorld, place: FloatArray) -> tuple[float, float, float]:
    """Height a + bx x + by y of the plane that the large shape is like below a place."""
    x, y = place[:2].tolist()
    bx, by = np.asarray(world.terrain.gradient(x, y)).reshape(2).tolist()
    return float(world.terrain.height(x, y)) - bx * x - by * y, bx, by
