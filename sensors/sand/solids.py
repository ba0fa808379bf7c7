"""Bodies on the sand (ellipsoids, rocks, wheels), their intersections with rays, and the rover's shadow."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.sand.grid import TEXEL, Bytes, Floats, Window
from vehicle.clock import TICK
from vehicle.frames import FloatArray, cross, inverse, rotation_zyx, transform
from vehicle.rover.description import Rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth


class Hits(NamedTuple):
    """Intersections of rays (...,) with a body; all but ``met`` are (n,), one for each of the n rays that hit."""

    met: NDArray[np.bool_]  # (...,) True for rays that hit
    depth: Floats  # along the rays
    facing: Floats  # cosine between sun and surface normal, 0 on the side away from the sun
    sky: Floats  # visible share of the sky
    albedo: Floats  # relative to sand


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """Rock: an ellipsoid with a rough skin."""

    X_WE: FloatArray  # (4, 4) pose of its middle and axes
    radii: tuple[float, float, float]  # [m]
    albedo: float

    @property
    def corners(self) -> FloatArray:
        """Corners of its bounding box (8, 3) in W; the skin has no height."""
        return _corners(self.X_WE, self.radii)

    def hit(self, eye: FloatArray, rays: Floats, sun: FloatArray) -> Hits:
        """Intersections with rays (..., 3) from an eye, all in W."""
        X_EW = inverse(self.X_WE)
        radii = np.asarray(self.radii)
        origin = (X_EW[:3, :3] @ eye + X_EW[:3, 3]) / radii
        along = (rays @ X_EW[:3, :3].T.astype(np.float32)) / radii.astype(np.float32)
        a, b, c = (along * along).sum(axis=-1), along @ origin.astype(np.float32), float(origin @ origin) - 1.0
        square = b * b - a * np.float32(c)
        met = square > 0.0
        depth = (-b[met] - np.sqrt(square[met])) / a[met]
        at = origin.astype(np.float32) + depth[:, None] * along[met]
        skin = _skin(at * np.float32(2.5 * max(self.radii) / 0.1))
        normal = (at + np.float32(0.15) * skin) / radii.astype(np.float32)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        facing = np.maximum(normal @ (X_EW[:3, :3] @ sun).astype(np.float32), 0.0)
        albedo = np.float32(self.albedo) * (1.0 + 0.12 * skin[..., 0])
        return Hits(met, depth.astype(np.float32), facing, 0.6 + 0.4 * normal[..., 2], albedo)


@dataclass(frozen=True, slots=True, eq=False)
class WheelBody:
    """Wheel of a rover: a cylinder of dull metal with lugs."""

    X_WK: FloatArray  # (4, 4) pose of its centre; x along its heading, y along its axle
    radius: float  # [m]
    width: float  # [m]
    lugs: int
    turned: float  # angle rolled [rad]
    albedo: float

    @property
    def corners(self) -> FloatArray:
        """Corners of its bounding box (8, 3) in W."""
        return _corners(self.X_WK, (self.radius, 0.5 * self.width, self.radius))

    def hit(self, eye: FloatArray, rays: Floats, sun: FloatArray) -> Hits:
        """Intersections with rays (..., 3) from an eye, all in W."""
        X_KW = inverse(self.X_WK)
        o = (X_KW[:3, :3] @ eye + X_KW[:3, 3]).astype(np.float32)
        x, y, z = np.moveaxis(rays @ X_KW[:3, :3].T.astype(np.float32), -1, 0)
        half, radius = np.float32(0.5 * self.width), np.float32(self.radius)
        a, b = x * x + z * z, x * o[0] + z * o[2]
        square = b * b - a * (o[0] ** 2 + o[2] ** 2 - radius**2)
        tread = (-b - np.sqrt(np.maximum(square, 0.0))) / np.maximum(a, np.float32(1e-9))
        on_tread = (square > 0.0) & (np.abs(o[1] + tread * y) < half)
        side, on_disc, disc = np.sign(o[1]), np.zeros_like(on_tread), tread
        if abs(o[1]) > half:
            disc = (side * half - o[1]) / np.where(np.abs(y) > 1e-6, y, np.float32(1e-6))
            on_disc = (disc > 0.0) & ((o[0] + disc * x) ** 2 + (o[2] + disc * z) ** 2 < radius**2)
            on_tread &= ~on_disc | (tread < disc)
        met = on_tread | on_disc
        first = on_tread[met]
        depth = np.where(first, tread[met], disc[met])
        at_x, at_z = o[0] + depth * x[met], o[2] + depth * z[met]
        return Hits(met, depth, *self._shaded(at_x, at_z, first, side, (X_KW[:3, :3] @ sun).astype(np.float32)))

    def _shaded(
        self, x: Floats, z: Floats, on_tread: NDArray[np.bool_], side: np.float32, sun: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Cosine of the sun, share of the sky and albedo (n,) at the points of intersection."""
        angle = np.arctan2(x, z)  # from the top, + forward, the direction of rolling
        lug = np.cos(self.lugs * (angle - np.float32(math.remainder(self.turned, 2.0 * math.pi))))
        slope = np.where(lug > 0.3, -0.5 * np.sqrt(1.0 - lug * lug), np.float32(0.0))
        nx = np.where(on_tread, (x + slope * z) / np.float32(self.radius), np.float32(0.0))
        nz = np.where(on_tread, (z - slope * x) / np.float32(self.radius), np.float32(0.0))
        ny = np.where(on_tread, np.float32(0.0), side)
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        facing = np.maximum((nx * sun[0] + ny * sun[1] + nz * sun[2]) / length, 0.0)
        albedo = np.float32(self.albedo) * np.where(on_tread & (lug > 0.55), np.float32(1.5), np.float32(1.0))
        return facing, np.asarray(0.5 + 0.5 * nz, dtype=np.float32), albedo


def _corners(X_WB: FloatArray, half: tuple[float, float, float]) -> FloatArray:
    """Corners (8, 3) in W of a box around B's origin, along its axes."""
    corners = np.stack(np.meshgrid(*((-side, side) for side in half)), axis=-1).reshape(-1, 3)
    return np.asarray(corners @ X_WB[:3, :3].T + X_WB[:3, 3])


def _skin(at: Floats) -> Floats:
    """Bumps (..., 3) of about -1 to 1 that do not repeat on one rock."""
    x, y, z = at[..., 0], at[..., 1], at[..., 2]
    one = np.sin(3.1 * x + 1.7 * y + 0.3) * np.sin(4.3 * y - 2.9 * z) + 0.5 * np.sin(9.7 * x - 7.3 * z + 5.1 * y)
    two = np.sin(3.7 * y + 2.3 * z + 1.1) * np.sin(5.1 * z - 2.1 * x) + 0.5 * np.sin(11.3 * y + 8.9 * x)
    three = np.sin(4.1 * z - 1.9 * x + 2.0) * np.sin(3.3 * x + 2.7 * y) + 0.5 * np.sin(10.1 * z + 9.1 * y - 4.7 * x)
    return np.asarray(np.stack([one, two, three], axis=-1) * 0.67, dtype=np.float32)


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
    def of(cls, rover: Rover, *, mast: bool, lugs: int) -> "Casters":
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
            cv2.GaussianBlur(layer, (0, 0), max(0.5 * _SUN_DISC * height / _CELL, 0.6)) if layer.min() < 255 else layer
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
            clouds.append((self.head @ rotation_zyx(turn, 0.0, 0.0).T + self.mast) @ R.T + p)
        for place, heading in zip(truth.wheel_positions, truth.wheel_headings, strict=True):
            clouds.append(self.wheel @ rotation_zyx(float(heading), 0.0, 0.0).T + place)
        return clouds


def _box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> FloatArray:
    """Corners (8, 3)."""
    return np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)
