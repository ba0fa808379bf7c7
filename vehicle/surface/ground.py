"""Ground under a vehicle: a plane or a cone with friction, and road roughness on top of it, as averaged by a tyre.

A track along a road has the displacement density Gd(n) = Gd(n0) (n/n0)^-2 over the spatial frequency n [cycles/m]. If
the road is as uneven in any other direction (isotropic), its density over the plane, S(k) with k^2 = nx^2 + ny^2,
follows: the track's one-sided density is 2 times the integral of S over all ny, and with S = c k^-3

    2 * integral of c (n^2 + ny^2)^(-3/2) d ny = 4 c n^-2,   hence   c = Gd(n0) n0^2 / 4.

A tyre averages over its contact patch, nearly as a Gaussian of standard deviation s: the density becomes
Gd(n) exp(-q^2) with q = 2 pi s n. The isotropic density with such tracks is its Abel inversion,

    S = c k^-3 (erfc(q) + 2 q exp(-q^2) / sqrt(pi))   with   q = 2 pi s k.

Two tracks d apart then have the cross density Gd(n) * X K1(X) with X = 2 pi n d, which is real: they are equal for
long waves (X -> 0 gives 1) and independent for short ones, which makes a vehicle roll.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from vehicle.foundation.quantity import check_number
from vehicle.frames import FloatArray, arc_length, rotation_zyx, transform
from vehicle.surface.friction import HIGHEST, LOWEST, Friction, friction_of
from vehicle.surface.relief import GroundRelief, MeasuredRoad

_WHEEL_RADIUS = 0.5  # of a truck's wheel, 0.48..0.53 m for 315/70 R 22.5 and 385/65 R 22.5 [m]
# Sizes are assumed: moderate to severe in terms of road maintenance. Potholes are counted from some 0.15 m on, which a
# truck's wheel hardly notices, and are filled before they are 1 m wide.
_DIAMETERS = (0.35, 0.95)  # [m]
_DEPTHS = (0.03, 0.09)  # [m]
_WHEEL_TRACK = 1.0  # of the wheels, to either side of the middle [m]
_WANDER = 0.3  # its standard deviation [m]
_REFERENCE = 0.1  # n0 of ISO 8608 [cycles/m]
# Gd(n0) [m3]: geometric means of the classes of ISO 8608, each four times the one before
ROAD_CLASSES: Final[Mapping[str, float]] = {name: 16e-6 * 4.0**i for i, name in enumerate("ABCDEFGH")}
_CELL = 0.1  # nodes of the field: waves down to 0.2 m, as short as a contact patch is long [m]
_NODES = 1024  # along each side of the tile: waves up to 102.4 m, of 0.3 Hz at 120 km/h; a power of two for the FFT
PATCH_SPREAD = 0.2 / np.sqrt(12.0)  # of the contact patch of a truck's tyre, 0.2 m long at its rated load [m]
_SLOPE = 0.5 * (np.sqrt(5.0) - 1.0)  # golden section: the slope whose line takes longest to come close to itself
_ALONG, _ACROSS = np.array([1.0, _SLOPE]) / np.hypot(1.0, _SLOPE) / _CELL  # (cos, sin) of the tile's rotation [nodes/m]
_MASK = _NODES - 1


class Potholes:
    """Round holes in the road.

    Args:
        x, y: W of their middles, (n,) [m].
        diameter: (n,) [m].
        depth: in the middle, (n,) [m].
    """

    def __init__(self, x: FloatArray, y: FloatArray, diameter: FloatArray, depth: FloatArray) -> None:
        self.x, self.y, self.diameter, self.depth = x, y, diameter, depth
        # A wheel that spans a hole drops by no more than the sagitta of its own circle.
        self._drop = np.minimum(depth, diameter**2 / (8.0 * _WHEEL_RADIUS))
        self._inverse_square = 4.0 / diameter**2

    def __len__(self) -> int:
        return len(self.x)

    def depth_at(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Drop of a wheel at x, y [m] into potholes [m].

        The wheel rolls in and out over the edge without a step: a bell (1 - (r/R)^2)^2 as wide as the hole.
        """
        square = (x[..., None] - self.x) ** 2 + (y[..., None] - self.y) ** 2
        inside = np.maximum(1.0 - square * self._inverse_square, 0.0)
        return (inside * inside) @ self._drop


class RoughProfile:
    """Heights of an isotropic rough road on a rotated periodic tile.

    The tile repeats without a seam. A straight road along x or y crosses it at the golden section, each time along
    another line, so that no track repeats itself: within 1 km it stays at least 4.8 m away from its earlier parts.
    """

    def __init__(self, rng: np.random.Generator, road_class: str) -> None:
        """Draw a road of that class, A to H (ISO 8608, geometric mean)."""
        phase = np.fft.rfft2(rng.standard_normal((_NODES, _NODES), dtype=np.float32))
        phase /= np.abs(phase)  # only phases are random: each road has exactly the unevenness of its class
        tile = np.fft.irfft2(phase * _amplitudes(road_class), s=(_NODES, _NODES)) * _NODES**2
        wrapped = np.pad(tile, ((0, 1), (0, 1)), mode="wrap")
        self._heights: NDArray[np.float32] = wrapped.astype(np.float32).ravel()

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height above the smooth ground [m] at x, y [m], linear between the nodes."""
        u, v = _ALONG * x + _ACROSS * y, _ALONG * y - _ACROSS * x
        u_node, v_node = np.floor(u), np.floor(v)
        a, b = u - u_node, v - v_node
        first = (v_node.astype(np.intp) & _MASK) * (_NODES + 1) + (u_node.astype(np.intp) & _MASK)
        z = self._heights
        z_0, z_1 = z[first], z[first + (_NODES + 1)]
        lower = z_0 + a * (z[first + 1] - z_0)
        upper = z_1 + a * (z[first + (_NODES + 2)] - z_1)
        height: FloatArray = lower + b * (upper - lower)
        return height


def _amplitudes(road_class: str) -> FloatArray:
    """Amplitude [m] of each wave of the tile, in the order of numpy's rfft2."""
    n_v, n_u = np.fft.fftfreq(_NODES, _CELL)[:, None], np.fft.rfftfreq(_NODES, _CELL)[None, :]  # [cycles/m]
    k = np.hypot(n_v, n_u)
    inside = (k > 0.0) & (k < 0.5 / _CELL)
    step = 1.0 / (_NODES * _CELL)  # between the waves' spatial frequencies [cycles/m]
    amplitude = step * np.sqrt(plane_psd(road_class, np.where(inside, k, 1.0), PATCH_SPREAD))
    # Linear interpolation between the nodes reduces each wave by sinc^2 along u and v.
    return np.asarray(np.where(inside, amplitude / (np.sinc(_CELL * n_u) * np.sinc(_CELL * n_v)) ** 2, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Roughness:
    """Roughness of a road on top of the smooth ground."""

    profile: RoughProfile | None = None
    potholes: Potholes | None = None
    measured: MeasuredRoad | None = None

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height of the road above the smooth ground [m] at x, y [m], of their common shape."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        height = self.waves(x, y)
        return height - self.potholes.depth_at(x, y) if self.potholes is not None else height

    def waves(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height without the potholes [m]."""
        if self.measured is None:
            return (
                np.zeros(np.broadcast_shapes(x.shape, y.shape)) if self.profile is None else self.profile.height(x, y)
            )
        measured = self.measured.height(x, y)
        return measured if self.profile is None else measured + self.profile.height(x, y)


def displacement_psd(road_class: str, n: FloatArray) -> FloatArray:
    """One-sided density Gd [m3] of a track's height at the spatial frequencies n [cycles/m]."""
    return np.asarray(ROAD_CLASSES[road_class] * (n / _REFERENCE) ** -2, dtype=np.float64)


def plane_psd(road_class: str, k: FloatArray, spread: float) -> FloatArray:
    """Two-sided density [m4] over the plane of spatial frequencies of modulus k > 0 [cycles/m], as a tyre feels it."""
    q = 2.0 * np.pi * spread * k
    averaged = scipy.special.erfc(q) + 2.0 * q * np.exp(-(q**2)) / np.sqrt(np.pi)
    return np.asarray(displacement_psd(road_class, k) / (4.0 * k) * averaged, dtype=np.float64)


def scattered_potholes(
    rng: np.random.Generator, centreline: FloatArray, road_half_width: float, per_100_m: float
) -> Potholes:
    """Random potholes along a road: half of them in the wheel tracks, half anywhere on it.

    Args:
        rng: for positions and sizes.
        centreline: of the road, (n, 2) [m].
        road_half_width: [m].
        per_100_m: number of potholes per 100 m of road.
    """
    along = arc_length(centreline)
    count = round(per_100_m * along[-1] / 100.0)
    diameter = _DIAMETERS[0] * (_DIAMETERS[1] / _DIAMETERS[0]) ** rng.random(count)
    # Wide ones are deeper
    depth = rng.uniform(_DEPTHS[0], _DEPTHS[1], size=count) * (0.4 + 0.6 * diameter / _DIAMETERS[1])
    room = road_half_width - 0.5 * diameter
    track = rng.choice([-_WHEEL_TRACK, _WHEEL_TRACK], size=count) + _WANDER * rng.standard_normal(count)
    offset = np.where(rng.random(count) < 0.5, track, rng.uniform(-1.0, 1.0, size=count) * room)
    offset = np.clip(offset, -room, room)
    middle, tangent = _along(centreline, along, rng.uniform(0.0, along[-1], size=count))
    return Potholes(middle[:, 0] - offset * tangent[:, 1], middle[:, 1] + offset * tangent[:, 0], diameter, depth)


def _along(line: FloatArray, along: FloatArray, station: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) of a polyline at stations [m], and its unit tangents there (n, 2)."""
    points = np.stack([np.interp(station, along, line[:, i]) for i in range(2)], axis=1)
    step = np.diff(line, axis=0)[np.clip(np.searchsorted(along, station) - 1, 0, len(line) - 2)]
    return points, step / np.linalg.norm(step, axis=1, keepdims=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Gust:
    """Side wind of one speed between two places, with edges over which it grows evenly."""

    speed: float  # along W's y, + to the left of one who drives along W's x [m/s]
    start: float  # along W's x [m]
    length: float  # [m]
    edge: float = 5.0  # over which it grows and falls [m]

    def velocity_at(self, x: ArrayLike) -> FloatArray:
        """Velocity along W's y [m/s] at x [m], of its shape."""
        x = np.asarray(x, dtype=np.float64)
        inside = np.minimum(x - self.start, self.start + self.length - x)
        return self.speed * np.clip(inside / self.edge + 0.5, 0.0, 1.0)


_APEX_RADIUS = 3.0  # rounding of the cone's tip, so that the slope is continuous there [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """Sloping ground with uniform or varying friction, smooth or rough.

    Without a ``centre`` the ground is a plane that rises along W's x by ``grade`` and falls to the right (-y) by
    ``cross_fall``. With one, the cross-fall is conical and falls away from the centre: the adverse camber of a
    roundabout. ``reliefs`` are added to either. ``height`` and ``gradient`` are those of the smooth ground, and
    ``roughness_at`` the height above it.
    """

    friction: Friction  # peak friction coefficient of tyre and ground [-]
    cross_fall: float = 0.0  # [-], 0.025 is 2.5 %
    grade: float = 0.0  # [-]
    centre: tuple[float, float] | None = None  # [m]
    roughness: Roughness | None = None
    gust: Gust | None = None  # wind across the road
    reliefs: tuple[GroundRelief, ...] = ()  # heights and banks of a road

    def __post_init__(self) -> None:
        if isinstance(self.friction, int | float):
            check_number("friction", self.friction, LOWEST, HIGHEST)
        for name, slope in (("cross_fall", self.cross_fall), ("grade", self.grade)):
            check_number(name, slope, -0.2, 0.2, why="a slope: 0.025 is 2.5 %")

    @property
    def is_uniform(self) -> bool:
        """True if the friction is one number everywhere."""
        return isinstance(self.friction, int | float)

    @property
    def is_plane(self) -> bool:
        """True if the smooth ground is a plane."""
        return self.centre is None and not self.reliefs

    @property
    def is_smooth(self) -> bool:
        """True if the road has neither roughness nor potholes."""
        return self.roughness is None

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height of the smooth ground [m] at x, y [m] in W, of any shape."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        height = self._even_height(x, y)
        return height + sum(relief.height(x, y) for relief in self.reliefs) if self.reliefs else height

    def _even_height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height of the plane or cone."""
        if self.centre is None:
            return self.grade * x + self.cross_fall * y
        distance = np.sqrt((x - self.centre[0]) ** 2 + (y - self.centre[1]) ** 2 + _APEX_RADIUS**2)
        return self.grade * x - self.cross_fall * distance

    def gradient(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] of the smooth ground at x, y [m]; shape (..., 2)."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        slope = self._even_gradient(x, y)
        return slope + sum(relief.gradient(x, y) for relief in self.reliefs) if self.reliefs else slope

    def _even_gradient(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Slope of the plane or cone."""
        if self.centre is None:
            slope = np.empty((*x.shape, 2))
            slope[..., 0], slope[..., 1] = self.grade, self.cross_fall
            return slope
        d_x, d_y = x - self.centre[0], y - self.centre[1]
        distance = np.sqrt(d_x**2 + d_y**2 + _APEX_RADIUS**2)
        slope = np.empty((*distance.shape, 2))  # np.stack takes four times as long for one vehicle
        slope[..., 0] = self.grade - self.cross_fall * d_x / distance
        slope[..., 1] = -self.cross_fall * d_y / distance
        return slope

    def friction_at(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Friction coefficient [-] at x, y [m], of their common shape."""
        return friction_of(self.friction, x, y)

    def roughness_at(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height of the road above the smooth ground [m] at x, y [m], of their common shape, averaged as by a tyre."""
        if self.roughness is None:
            return np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
        return self.roughness.height(x, y)

    def pose_on(self, x: float, y: float, psi: float, supports: tuple[float, float]) -> FloatArray:
        """X_WB (4, 4) of a body at x, y [m] with heading psi [rad] that stands on two points of its x axis.

        ``supports`` are their positions along that axis [m], front and rear, such as hitch and axles of a semi-trailer.
        The roll follows the mean cross-slope of the smooth ground at the two points.
        """
        c, s = np.cos(psi), np.sin(psi)
        along = np.array(supports)
        at_x, at_y = x + along * c, y + along * s
        front, rear = self.height(at_x, at_y)
        rise = (front - rear) / (along[0] - along[1])
        across = float(np.mean(self.gradient(at_x, at_y) @ np.array([-s, c])))
        pitch = -np.arctan(rise)  # nose up is negative pitch about +y
        roll = np.arctan(across * np.cos(pitch))
        origin = np.array([x, y, rear - rise * along[1]])
        return transform(rotation_zyx(psi, float(pitch), float(roll)), origin)
