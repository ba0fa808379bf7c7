"""Ground under a vehicle: a plane or a cone with friction, road roughness on top of it, and gusts above it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vehicle.foundation.quantity import check_number
from vehicle.frames import FloatArray, rotation_zyx, transform
from vehicle.surface.friction import Friction, check_friction, friction_of
from vehicle.surface.relief import GroundRelief
from vehicle.surface.roughness import Roughness


@dataclass(frozen=True, slots=True, kw_only=True)
class Gust:
    """Side wind of one speed between two places, with edges over which it grows evenly."""

    speed: float  # along W's y, + to the left of one who drives along W's x [m/s]
    start: float  # along W's x [m]
    length: float  # [m]
    edge: float = 5.0  # over which it grows and falls [m]

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            ValueError: one line naming the number, its value and limit.
        """
        for name, value, low, high, unit in (
            ("speed", self.speed, -60.0, 60.0, "m/s"),
            ("length", self.length, 0.1, 1e5, "m"),
            ("edge", self.edge, 0.1, 1e3, "m"),
            ("start", self.start, -1e6, 1e6, "m"),
        ):
            check_number(f"gust: {name}", value, low, high, unit)

    def velocity_at(self, x: ArrayLike) -> FloatArray:
        """Velocity along W's y [m/s] at x [m], of its shape."""
        x = np.asarray(x, dtype=np.float64)
        inside = np.minimum(x - self.start, self.start + self.length - x)
        velocity: FloatArray = self.speed * np.clip(inside / self.edge + 0.5, 0.0, 1.0)
        return velocity


_APEX_RADIUS = 3.0  # rounding of the cone's tip, so that the slope is continuous there [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """Sloping ground with uniform or varying friction, smooth or rough.

    Without a ``centre`` the ground is a plane that rises along W's x by ``grade`` and falls to the right (-y) by
    ``cross_fall``. With one, the cross-fall is conical and falls away from the centre: the adverse camber of a
    roundabout. A ``relief`` is added to either. ``height`` and ``gradient`` are those of the smooth ground, and
    ``roughness_at`` the height above it.
    """

    friction: Friction  # peak friction coefficient of tyre and ground [-]
    cross_fall: float = 0.0  # [-], 0.025 is 2.5 %
    grade: float = 0.0  # [-]
    centre: tuple[float, float] | None = None  # [m]
    roughness: Roughness | None = None
    gust: Gust | None = None  # wind across the road
    relief: GroundRelief | None = None  # heights and banks of a road

    def __post_init__(self) -> None:
        check_friction("friction", self.friction)
        for name, slope in (("cross_fall", self.cross_fall), ("grade", self.grade)):
            check_number(name, slope, -0.2, 0.2, why="a slope: 0.025 is 2.5 %")

    @property
    def is_uniform(self) -> bool:
        """True if the friction is one number everywhere."""
        return isinstance(self.friction, int | float)

    @property
    def is_plane(self) -> bool:
        """True if the smooth ground is a plane."""
        return self.centre is None and self.relief is None

    @property
    def is_smooth(self) -> bool:
        """True if the road has neither roughness nor potholes."""
        return self.roughness is None

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height of the smooth ground [m] at x, y [m] in W, of any shape."""
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        height = self._even_height(x, y)
        return height if self.relief is None else height + self.relief.height(x, y)

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
        return slope if self.relief is None else slope + self.relief.gradient(x, y)

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
