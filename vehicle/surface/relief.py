"""Ground along a road: height and bank by the distance along a line, designed or measured.

A vehicle stands on the smooth ground and its suspension works on the roughness. Waves of the measured heights longer
than ``PROFILE_WAVES`` are smooth ground: mean height and bank of the cross sections, averaged by a Gaussian that passes
half of a wave of that length. The rest is roughness, averaged by the tyre's contact patch. Both together are the
measured heights. At 90 km/h a wave of that length comes every 2 s, slower than a body bounces on its springs.
"""

from typing import Final, Literal, NamedTuple, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike

from vehicle.frames import FloatArray, arc_length

# Least of 1 - curvature * offset: beyond it, distances along the line are not stretched
_NEAREST_TO_CENTRE: Final = 0.2


class Beside(NamedTuple):
    """Places relative to the nearest point of a line, arrays of one shape."""

    along: FloatArray  # distance along the line [m]
    across: FloatArray  # to the left of it [m]
    heading: FloatArray  # of the line there [rad]
    stretch: FloatArray  # distance travelled at that offset, over the distance along the line [-]


class BesideLine:
    """A line of points (n, 2) closer than a metre [m], and the places around it."""

    def __init__(self, line: FloatArray) -> None:
        self.along = arc_length(line)  # (n,) [m]
        self._line, self._tree = line, scipy.spatial.KDTree(line)
        tangents = np.gradient(line, self.along, axis=0)
        self._heading = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
        self._curvature = np.gradient(self._heading, self.along)

    def at(self, x: ArrayLike, y: ArrayLike) -> Beside:
        """Places x, y [m] relative to the nearest point of the line; beyond an end, to that end."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        _, k = self._tree.query(np.stack([x, y], axis=-1))
        d_x, d_y = x - self._line[k, 0], y - self._line[k, 1]
        c, sin, curvature = np.cos(self._heading[k]), np.sin(self._heading[k]), self._curvature[k]
        ahead, across = c * d_x + sin * d_y, c * d_y - sin * d_x
        stretch = np.maximum(1.0 - curvature * across, _NEAREST_TO_CENTRE)
        ahead = ahead / stretch
        along = np.clip(self.along[k] + ahead, 0.0, self.along[-1])
        return Beside(along, across - 0.5 * curvature * ahead**2, self._heading[k] + curvature * ahead, stretch)

    def place(self, along: FloatArray, across: FloatArray) -> FloatArray:
        """Places (n, 2) [m] at distances along the line and to its left (n,) [m]."""
        heading = np.interp(along, self.along, self._heading)
        middle = np.stack([np.interp(along, self.along, self._line[:, i]) for i in range(2)], axis=-1)
        places: FloatArray = middle + across[:, None] * np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return places


STEEPEST: Final = 0.2  # slope and bank, as of other surfaces [-]


class GroundRelief(Protocol):
    """Height of ground above a plane or cone."""

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height [m] at x, y [m] in W, of their common shape."""
        ...

    def gradient(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] at x, y [m]; shape (..., 2)."""
        ...


class RoadRelief:
    """Height and slope of the ground around a line.

    Across the line the ground rises by its bank, up to ``reach`` [m] to either side; beyond that it keeps the height
    of there. The nearest point of the line decides. Beyond its ends the ground is level. Messages count stations [m]
    from ``begin`` on.

    Raises:
        ValueError: if the line has a slope or bank beyond ``STEEPEST``.
    """

    def __init__(
        self, line: FloatArray, heights: FloatArray, banks: FloatArray, *, reach: float, begin: float = 0.0
    ) -> None:
        """Relief of a line of points (n, 2) closer than a metre, with heights [m] and banks (n,) [-], + rises left."""
        self._beside, self._reach = BesideLine(line), reach
        along = self._beside.along
        self._height, self._bank = (scipy.interpolate.CubicSpline(along, values) for values in (heights, banks))
        self._slope, self._twist = self._height.derivative(), self._bank.derivative()
        for name, values in (("slope", self._slope(along)), ("bank", banks)):
            worst = int(np.argmax(np.abs(values)))
            if abs(values[worst]) > STEEPEST:
                raise ValueError(
                    f"{name} = {values[worst]:.3f} at {begin + along[worst]:.1f} m must be within {STEEPEST}"
                )

    def height(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Height [m] at x, y [m] in W, of their common shape."""
        s, across, _, _ = self._beside.at(x, y)
        return self._height(s) + self._bank(s) * np.clip(across, -self._reach, self._reach)

    def gradient(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """Slope (dz/dx, dz/dy) [-] at x, y [m]; shape (..., 2)."""
        s, across, heading, stretch = self._beside.at(x, y)
        inside = np.abs(across) < self._reach
        offset = np.clip(across, -self._reach, self._reach)
        along = (self._slope(s) + self._twist(s) * offset) / stretch
        along = np.where((s > 0.0) & (s < self._beside.along[-1]), along, 0.0)
        rise = np.where(inside, self._bank(s), 0.0)
        c, sin = np.cos(heading), np.sin(heading)
        return np.stack([along * c - rise * sin, along * sin + rise * c], axis=-1)


PROFILE_WAVES: Final = 50.0  # [m]
_AVERAGED: Final = PROFILE_WAVES * np.sqrt(0.5 * np.log(2.0)) / np.pi  # deviation of that Gaussian [m]
_STATION: Final = 0.1  # between the stations of the profile [m]
_FADE: Final = 2.0  # length over which the roughness ends beyond the grid [m]
_BANK_FADE: Final = 20.0  # length over which the bank ends there [m]

Beyond = Literal["level", "mirrored"]


class MeasuredRoad:
    """Heights of a road measured on a grid, laid along a line.

    Beside the grid, the height of its edge goes on. Before and after it, ``beyond`` decides: "level" ends the roughness
    over 2 m and the bank over 20 m, "mirrored" runs through the grid backwards, forwards, and so on.
    """

    def __init__(
        self,
        line: FloatArray,
        heights: FloatArray,
        *,
        u_step: float,
        v: FloatArray,
        start: float = 0.0,
        beyond: Beyond = "level",
        tyre_spread: float,
    ) -> None:
        """Lay a grid along a line.

        Args:
            line: points (n, 2), closer than a metre [m].
            heights: (nu, nv) at ``start + i * u_step`` along the line and ``v[j]`` to its left, all finite [m].
            u_step: [m].
            v: (nv,) evenly spaced, rising [m].
            start: station of the line at which the grid begins [m].
            beyond: what follows the grid, and comes before it.
            tyre_spread: standard deviation of the Gaussian by which a tyre averages [m].

        Raises:
            ValueError: if the profile has a slope or bank that no ground may have.
        """
        self._beside, self._v, self._u_step, self._start, self._beyond = BesideLine(line), v, u_step, start, beyond
        self._length = (len(heights) - 1) * u_step
        self._reach = float(np.abs(v).max())
        spread = tyre_spread / np.array([u_step, (v[-1] - v[0]) / (len(v) - 1)])
        averaged: FloatArray = scipy.ndimage.gaussian_filter(heights, spread, mode="nearest")
        mean, bank = _cross_sections(averaged, v)
        self._rest = (averaged - mean[:, None] - bank[:, None] * v).astype(np.float32)
        self._along_grid = np.arange(len(heights)) * u_step
        self._mean, self._bank = mean - mean[0], bank
        self._stations = np.arange(0.0, self._beside.along[-1] + _STATION, _STATION)
        self._smooth_mean, self._smooth_bank = (
            scipy.ndimage.gaussian_filter1d(values, _AVERAGED / _STATION, mode="nearest")
            for values in self._sections(*self._in_grid(self._stations))
        )
        self.relief = RoadRelief(  # the profile
            line,
            np.interp(self._beside.along, self._stations, self._smooth_mean),
            np.interp(self._beside.along, self._stations, self._smooth_bank),
            reach=self._reach,
        )

    @property
    def highest(self) -> float:
        """Largest height of the grid above or below the profile, apart from slow waves [m]."""
        smooth = scipy.ndimage.gaussian_filter1d(self._mean, _AVERAGED / self._u_step, mode="nearest")
        return float(np.abs(self._rest + (self._mean - smooth)[:, None]).max())

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Height of the roughness above the profile [m] at x, y [m], of their common shape."""
        s, across, _, _ = self._beside.at(x, y)
        u, outside = self._in_grid(s)
        mean, bank = self._sections(u, outside)
        mean = mean - np.interp(s, self._stations, self._smooth_mean)
        bank = bank - np.interp(s, self._stations, self._smooth_bank)
        rest = self._interpolated(u, across) * _faded(outside, _FADE)
        return np.asarray(mean + bank * np.clip(across, -self._reach, self._reach) + rest)

    def uneven_places(self, limit: float, over: float) -> FloatArray:
        """Places (n, 2) [m] whose height differs by more than ``limit`` [m] from the mean ``over`` [m] around."""
        v_step = (self._v[-1] - self._v[0]) / (len(self._v) - 1)
        size = [max(1, round(over / step)) for step in (self._u_step, v_step)]
        heights = self._rest + self._mean[:, None] + self._bank[:, None] * self._v
        mean = scipy.ndimage.uniform_filter(heights, size, mode="nearest")
        rows, columns = np.nonzero(np.abs(heights - mean) > limit)
        u, v = rows * self._u_step, self._v[columns]
        first, last = (int((s - self._start) // self._length) for s in (0.0, float(self._beside.along[-1])))
        rounds = range(first, last + 1) if self._beyond == "mirrored" else range(1)
        places = []
        for k in rounds:
            along = self._start + k * self._length + (u if k % 2 == 0 else self._length - u)
            on_line = (along >= 0.0) & (along <= self._beside.along[-1])
            places.append(self._beside.place(along[on_line], v[on_line]))
        return np.concatenate(places)

    def _in_grid(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance u along the grid [m] of stations s [m], and how far these lie outside of it [m]."""
        from_start = s - self._start
        if self._beyond == "mirrored":
            u = np.abs((from_start + self._length) % (2.0 * self._length) - self._length)
            return u, np.zeros_like(u)
        u = np.clip(from_start, 0.0, self._length)
        return u, np.abs(from_start - u)

    def _sections(self, u: FloatArray, outside: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Height at the line [m] and bank [-] of the cross sections at u along the grid."""
        bank = np.interp(u, self._along_grid, self._bank) * _faded(outside, _BANK_FADE)
        return np.interp(u, self._along_grid, self._mean), np.asarray(bank)

    def _interpolated(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Heights of the grid above its cross sections, linear between its nodes [m]."""
        rows, columns = self._rest.shape
        a = u / self._u_step
        b = (np.clip(v, self._v[0], self._v[-1]) - self._v[0]) * ((columns - 1) / (self._v[-1] - self._v[0]))
        i = np.minimum(a.astype(np.intp), rows - 2)
        j = np.minimum(b.astype(np.intp), columns - 2)
        a, b, z = a - i, b - j, self._rest
        right = z[i, j] + a * (z[i + 1, j] - z[i, j])
        left = z[i, j + 1] + a * (z[i + 1, j + 1] - z[i, j + 1])
        return np.asarray(right + b * (left - right))


def _cross_sections(heights: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height at v = 0 [m] and bank [-] of the straight line nearest to each cross section, (nu,) each."""
    from_middle = v - v.mean()
    bank = heights @ from_middle / (from_middle @ from_middle)
    return heights.mean(axis=1) - bank * v.mean(), bank


def _faded(outside: FloatArray, length: float) -> FloatArray:
    """Weight 1 inside, falling smoothly to 0 over a length [m] outside."""
    share = np.clip(1.0 - outside / length, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)
