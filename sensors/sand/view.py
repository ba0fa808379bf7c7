"""View of a camera onto a field of sand: its rays are traced to the relief with its ruts.

Only rays between every second row and column of pixels are traced, the others are interpolated. The error is below the
relief within two pixels, some tenths of a millimetre.
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
from sensors.sand.light import decoded
from sensors.sand.solids import Hits
from sensors.sand.world import SandWorld
from vehicle.frames import FloatArray

_STEPS: Final = 3  # of the fixed-point iteration; each reduces the error by slope times tangent of the view angle
_AROUND: Final = 0.05  # margin around the ground that is visible by plane geometry [m]
_BORDER: Final = 4  # of rays around the image [px]
_NEAREST: Final = 0.1  # smallest depth of a body [m]
_BOWED: Final = 6  # largest bend of a straight edge by the lens [px]
_LEAST_FALL: Final = 0.05  # smallest descent of a ray to the ground, over its depth


class Body(Protocol):
    """Body on the ground, such as ``sensors.sand.solids.Ellipsoid``."""

    @property
    def corners(self) -> FloatArray:
        """Corners of its bounding box (8, 3) in W [m]."""
        ...

    def hit(self, eye: FloatArray, rays: Floats, sun: FloatArray) -> Hits:
        """Intersections with rays (..., 3) from an eye."""
        ...


class VisibleGround(NamedTuple):
    """Place on the ground that each pixel of an image shows."""

    window: Window
    u: Floats  # (h, w) column and row in the window [texels]
    v: Floats
    x: Floats  # (h / 2, w / 2) in W, of one ray for four pixels, and a border around the image [m]
    y: Floats
    z: Floats


@dataclass(frozen=True, slots=True, eq=False)
class GroundView:
    """Ray tracer of one camera."""

    camera: CameraModel
    rays: Floats  # (2, h, w) x and y at depth 1 of each pixel
    between: Floats  # (2, h / 2 + .., w / 2 + ..) the same for the traced rays, one between four pixels, and a border

    @classmethod
    def of(cls, camera: CameraModel) -> GroundView:
        """Ray tracer for all pixels of a camera."""
        v, u = np.mgrid[0.0 : camera.height, 0.0 : camera.width]
        row = np.arange(0.5 - _BORDER, camera.height + _BORDER - 1, 2.0)
        column = np.arange(0.5 - _BORDER, camera.width + _BORDER - 1, 2.0)
        pixels = np.stack([u, v], axis=-1), np.stack(np.meshgrid(column, row), axis=-1)
        rays, between = (np.ascontiguousarray(np.moveaxis(camera.rays(at), -1, 0), dtype=np.float32) for at in pixels)
        return cls(camera, rays, between)

    def full(self, half: Floats) -> Floats:
        """Image for all pixels from values of the traced rays."""
        rows, columns = self.rays.shape[1:]
        wide = cv2.resize(half, (2 * half.shape[1], 2 * half.shape[0]), interpolation=cv2.INTER_LINEAR)
        return np.asarray(wide[_BORDER : _BORDER + rows, _BORDER : _BORDER + columns], dtype=np.float32)

    def footprint(self, X_WC: FloatArray, world: SandWorld) -> FloatArray:
        """Outline (n, 2) of the visible ground, taken as a plane [m].

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

    def look(self, X_WC: FloatArray, world: SandWorld) -> VisibleGround:
        """Visible ground from X_WC (4, 4)."""
        window = window_around(self.footprint(X_WC, world), _AROUND)
        height, eye, corner = world.height(window), X_WC[:3, 3], window.corner
        rx, ry, rz = _turned(self.between, X_WC)
        kx, ky = rx / rz, ry / rz  # horizontal distance of a ray per metre of rise
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
        return VisibleGround(window, self.full(u), self.full(v), x, y, down + np.float32(eye[2]))

    def light(self, ground: VisibleGround, world: SandWorld) -> tuple[Floats, Floats]:
        """Shares of the light of sun and sky that open ground reflects to every pixel."""
        direct, ambient = (decoded(_looked_up(plane, ground.u, ground.v)) for plane in world.lit(ground.window))
        return direct, ambient

    def tint(self, ground: VisibleGround, world: SandWorld) -> Floats:
        """Greyness of the ground at every pixel, 0 to 1."""
        tint = _looked_up(world.tint(ground.window), ground.u, ground.v)
        return np.asarray(tint / 255.0, dtype=np.float32)

    def draw(
        self,
        bodies: Iterable[Body],
        X_WC: FloatArray,
        ground: VisibleGround,
        sun: FloatArray,
        direct: Floats,
        ambient: Floats,
    ) -> NDArray[np.bool_]:
        """Draw the visible parts of bodies into the shares of light.

        Returns:
            Mask of the pixels in which they hide the ground.
        """
        z, hidden = self.full(ground.z), np.zeros(direct.shape, dtype=bool)
        for body in bodies:
            part = self._part(X_WC, body.corners)
            if part is None:
                continue
            rays = np.stack(_turned(self.rays[:, *part], X_WC), axis=-1)
            hits = body.hit(X_WC[:3, 3], rays, sun)
            to_ground = (z[part][hits.met] - np.float32(X_WC[2, 3])) / rays[..., 2][hits.met]
            first = hits.depth < to_ground
            shown = hits.met
            shown[hits.met] = first
            direct[part][shown] = 0.5 * (hits.facing * hits.albedo)[first]
            ambient[part][shown] = 0.5 * (hits.sky * hits.albedo)[first]
            hidden[part] |= shown
        return hidden

    def _part(self, X_WC: FloatArray, corners: FloatArray) -> tuple[slice, slice] | None:
        """Rows and columns that show a box with corners (n, 3) in W; None if it is out of view."""
        p_C = (corners - X_WC[:3, 3]) @ X_WC[:3, :3]
        if p_C[:, 2].min() < _NEAREST:
            return None  # too near to be drawn
        u, v = self.camera.project(p_C).T
        rows, columns = (
            slice(max(0, int(at.min()) - _BOWED), min(size, int(at.max()) + _BOWED + 1))
            for at, size in ((v, self.camera.height), (u, self.camera.width))
        )
        return None if rows.stop <= rows.start or columns.stop <= columns.start else (rows, columns)


def _turned(rays: Floats, X_WC: FloatArray) -> list[Floats]:
    """Components in W (x, y, z) of rays (2, ...) with depth 1."""
    x, y = rays
    turned = []
    for along_x, along_y, along_z in X_WC[:3, :3].astype(np.float32):
        along = along_x * x
        along += along_y * y
        along += along_z
        turned.append(along)
    return turned


def _looked_up(layer: Floats | NDArray[np.uint8], u: Floats, v: Floats) -> Floats:
    values = cv2.remap(layer, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float32)


def _plane(world: SandWorld, place: FloatArray) -> tuple[float, float, float]:
    """Coefficients (a, bx, by) of the plane a + bx x + by y that is tangent to the large shape below a place."""
    x, y = place[:2].tolist()
    bx, by = np.asarray(world.terrain.gradient(x, y)).reshape(2).tolist()
    return float(world.terrain.height(x, y)) - bx * x - by * y, bx, by
