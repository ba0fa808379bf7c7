"""Reversing law: steers a combination backwards so that its last axle follows a path.

State feedback on the tractor's front wheels, as Rimmer & Cebon 2015, "Theory and practice of reversing control on
multiply-articulated vehicles", J. Automobile Engineering (abstract read), whose last unit tracks a path within 0.4 m.
The gains are derived here: a linear-quadratic regulator about the steady turn of each path curvature, over the arc
length of the last axle, so that they do not depend on speed. Articulation and steer angle of the error-free motion are
fed forward.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import scipy

from vehicle.combination.description import Vehicle
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray, Pose2


@dataclass(frozen=True, slots=True, kw_only=True)
class RollingChain:
    """Lengths of a tractor and its towed units, each on one axle without steering."""

    wheelbase: float  # of the tractor [m]
    max_steer: float  # of its front wheels [rad]
    hitches: tuple[float, ...]  # of every unit but the last: from its axle forward to its rear hitch [m]
    lengths: tuple[float, ...]  # of every towed unit: hitch to axle [m]

    @classmethod
    def of(cls, vehicle: Vehicle) -> "RollingChain":
        """The lengths of a vehicle.

        Raises:
            ValueError: if it tows nothing, or its tractor has no steering.
        """
        tractor, *towed = vehicle.units
        if not towed or tractor.steering is None:
            raise ValueError(f"vehicle {vehicle.name}: must be a tractor with steering that tows a trailer")
        axles = [0.0, *(_rolling_axle(unit) for unit in towed)]  # T has its origin at the rear axle
        return cls(
            wheelbase=tractor.steered_axles[0].x,
            max_steer=tractor.steering.limit,
            hitches=tuple(unit.rear_hitch[0] - x for unit, x in zip(vehicle.units[:-1], axles, strict=False)),
            lengths=tuple(-x for x in axles[1:]),
        )

    def last_axle(self, X_WT: Pose2, articulation: Sequence[float]) -> Pose2:
        """Pose of the last unit's axle for the articulation (N,) at each hitch [rad]."""
        x, y, psi = X_WT
        for hitch, length, gamma in zip(self.hitches, self.lengths, articulation, strict=True):
            ahead, psi = psi, psi - gamma
            x += hitch * math.cos(ahead) - length * math.cos(psi)
            y += hitch * math.sin(ahead) - length * math.sin(psi)
        return Pose2(x, y, psi)

    def rates(self, articulation: FloatArray, curvature: float) -> tuple[FloatArray, FloatArray]:
        """Speeds (N + 1,) and yaw rates (N + 1,) of all axles per metre of the tractor's on a ``curvature`` [1/m]."""
        speeds, yaw_rates = np.ones(1 + len(self.lengths)), np.full(1 + len(self.lengths), curvature)
        for k, (hitch, length) in enumerate(zip(self.hitches, self.lengths, strict=True), start=1):
            c, s = math.cos(articulation[k - 1]), math.sin(articulation[k - 1])
            v_x, v_y = speeds[k - 1], hitch * yaw_rates[k - 1]
            speeds[k], yaw_rates[k] = c * v_x - s * v_y, (s * v_x + c * v_y) / length
        return speeds, yaw_rates

    def steady(self, curvature: float) -> tuple[FloatArray, float]:
        """Articulation (N,) [rad] and the tractor's curvature [1/m] for a curvature of the last axle's path [1/m].

        On a path of curvature k a hitch at the distance d from its axle travels at the angle atan(d k) to the unit. The
        distance from a hitch to the turning centre is the same for both of its units.
        """
        articulation: list[float] = []
        for hitch, length in zip(reversed(self.hitches), reversed(self.lengths), strict=True):
            ahead = curvature / math.sqrt(1.0 + curvature**2 * (length**2 - hitch**2))
            articulation.insert(0, math.atan(length * curvature) - math.atan(hitch * ahead))
            curvature = ahead
        return np.array(articulation), curvature


def _rolling_axle(unit: Unit) -> float:
    """Position of the single axle that is equivalent to a unit's axle group [m].

    The hitch transmits any side force but no moment: sum x F = 0 with forces in proportion to slip, hence
    r = -u sum x / sum x^2.
    """
    positions = [axle.x for axle in unit.axles]
    return sum(x * x for x in positions) / sum(positions)


_SPACING: Final = 0.1  # of the reference's points [m]
_SMOOTHING: Final = 0.6  # of the given points: cuts a curve of 10 m radius by 2 cm [m]
_EXTENSION: Final = 8.0  # at both ends [m]
_END: Final = 3.0  # length whose arc is continued there [m]
_LEAST: Final = 1.0  # length of the given points [m]
_PROJECTION_STEPS: Final = 4  # Newton from the previous step, a centimetre away
_NO_LEVER: Final = 0.02  # a hitch closer to its axle moves as the axle does [m]


class ReferencePoint(NamedTuple):
    """A point of the reference."""

    pose: Pose2  # of the last axle, pointing forwards; the heading counts full turns
    curvature: float  # of the last axle's path, + left [1/m]
    articulation: FloatArray  # (N,) at each hitch [rad]
    tractor_curvature: float  # of the tractor's rear axle [1/m]


@dataclass(frozen=True, slots=True, eq=False)
class ReverseReference:
    """Path of the last axle by station; stations grow forwards and fall in reverse."""

    stations: FloatArray  # (n,) [m]
    path: FloatArray  # (n, 2) [m]
    headings: FloatArray  # (n,) [rad]
    curvatures: FloatArray  # (n,) [1/m]
    articulations: FloatArray  # (n, N) [rad]
    tractor_curvatures: FloatArray  # (n,) [1/m]

    @classmethod
    def of(cls, chain: RollingChain, points: FloatArray) -> "ReverseReference":
        """The reference through points (n, 2) [m] of the last axle's path, in the order of forward travel.

        Station 0 is at the first point.

        Raises:
            ValueError: if the points span less than 1 m.
        """
        path, first = _resampled(points)
        headings = _directions(path)
        stations: FloatArray = np.linspace(-first, _SPACING * (len(path) - 1) - first, len(path))
        axle, psi = path, headings
        articulations: list[FloatArray] = []
        for hitch, length in zip(reversed(chain.hitches), reversed(chain.lengths), strict=True):
            hitch_path = axle + length * _along(psi)
            towing = _towing(hitch_path, hitch)
            articulations.insert(0, towing - psi)
            axle, psi = hitch_path - hitch * _along(towing), towing
        tractor_steps = np.hypot(*np.gradient(axle, axis=0).T)
        return cls(
            stations=stations,
            path=path,
            headings=headings,
            curvatures=np.gradient(headings, _SPACING),
            articulations=np.column_stack(articulations),
            tractor_curvatures=np.gradient(psi) / tractor_steps,
        )

    def at(self, station: float) -> ReferencePoint:
        """The reference at a station [m]."""
        k = (station - self.stations[0]) / _SPACING
        i = min(max(int(k), 0), len(self.stations) - 2)
        share = k - i

        def between(values: FloatArray) -> FloatArray:
            interpolated: FloatArray = values[i] + share * (values[i + 1] - values[i])
            return interpolated

        x, y = between(self.path).tolist()
        return ReferencePoint(
            pose=Pose2(x, y, float(between(self.headings))),
            curvature=float(between(self.curvatures)),
            articulation=between(self.articulations),
            tractor_curvature=float(between(self.tractor_curvatures)),
        )

    def project(self, x: float, y: float, near: float) -> float:
        """Station [m] of the point nearest to x, y [m], around the station ``near`` [m]."""
        s = near
        for _ in range(_PROJECTION_STEPS):
            on = self.at(s)
            c, sin = math.cos(on.pose.psi), math.sin(on.pose.psi)
            across = c * (y - on.pose.y) - sin * (x - on.pose.x)
            s += (c * (x - on.pose.x) + sin * (y - on.pose.y)) / max(1.0 - on.curvature * across, 0.5)
        return s


def _resampled(points: FloatArray) -> tuple[FloatArray, float]:
    """Smoothed and extended points at equal spacing, and the arc length of the first given one [m]."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    kept = np.concatenate([[True], steps > 1e-6])
    points, s = points[kept], np.concatenate([[0.0], np.cumsum(steps[kept[1:]])])
    if s[-1] < _LEAST:
        raise ValueError(f"points span {s[-1]:.2f} m: reversing needs {_LEAST:g} m at least")
    beyond = np.arange(_SPACING, _EXTENSION, _SPACING)
    before, behind = _extension(points[::-1], s[-1] - s[::-1], beyond)[::-1], _extension(points, s, beyond)
    s = np.concatenate([-beyond[::-1], s, s[-1] + beyond])
    stations = np.arange(s[0], s[-1], _SPACING)
    line = np.column_stack([np.interp(stations, s, column) for column in np.vstack([before, points, behind]).T])
    smooth = scipy.ndimage.gaussian_filter1d(line, _SMOOTHING / _SPACING, axis=0, mode="nearest", truncate=3.0)
    margin = math.ceil(3.0 * _SMOOTHING / _SPACING) + 1  # within reach of the filter's ends
    return smooth[margin:-margin], -s[0] - margin * _SPACING


def _extension(points: FloatArray, s: FloatArray, beyond: FloatArray) -> FloatArray:
    """Points at distances ``beyond`` (m,) [m] after the end of a path, on the arc of its last part."""
    low = max(0.0, s[-1] - _END)
    a, b, c = (np.array([np.interp(at, s, column) for column in points.T]) for at in (low, 0.5 * (low + s[-1]), s[-1]))
    first, second = (math.atan2(*(chord[::-1])) for chord in (b - a, c - b))
    half = 0.5 * (s[-1] - low)
    curvature = math.remainder(second - first, math.tau) / half
    headings = second + curvature * (0.5 * half + beyond - 0.5 * _SPACING)
    return c + _SPACING * np.cumsum(_along(headings), axis=0)


def _directions(path: FloatArray) -> FloatArray:
    """Direction of a path at each of its points [rad], continuous."""
    tangents = np.gradient(path, axis=0)
    return np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))


def _towing(hitch_path: FloatArray, hitch: float) -> FloatArray:
    """Heading [rad] of the unit whose hitch, ``hitch`` [m] ahead of its axle, moves along the points (n, 2).

    Between two points the hitch moves straight, and the tangent of half the heading's angle to that line falls by the
    factor e every ``hitch``. With a hitch behind the axle this is stable only in the opposite direction.
    """
    directions = _directions(hitch_path)
    if abs(hitch) < _NO_LEVER:
        return directions
    decay = np.exp(-np.hypot(*np.diff(hitch_path, axis=0).T) / abs(hitch))
    order = range(1, len(hitch_path)) if hitch > 0.0 else range(len(hitch_path) - 2, -1, -1)
    headings = directions.copy()
    for k in order:
        before, factor = (k - 1, decay[k - 1]) if hitch > 0.0 else (k + 1, decay[k])
        middle = 0.5 * (directions[before] + directions[k])
        headings[k] = middle + 2.0 * math.atan(factor * math.tan(0.5 * (headings[before] - middle)))
    return headings


def _along(psi: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(psi), np.sin(psi)])


_LATERAL_ERROR: Final = 0.7  # weighs as much as ... [m]
_CURVATURE: Final = 0.1  # ... this change of the tractor's curvature [1/m]
_STEEPEST: Final = 0.6  # approach angle to the path at most, at any distance from it [rad]
_MOST_FOLDED: Final = math.radians(65.0)  # articulation beyond which no gain is designed
_DESIGNS: Final = 9  # curvatures from straight to the tightest turn, to either side
_DIFFERENCE: Final = 1e-6  # [rad], [m], [1/m]


class ReversingLaw:
    """State feedback in reverse, for any number of hitches."""

    def __init__(self, chain: RollingChain) -> None:
        """Design the gains."""
        self._chain = chain
        tightest = _tightest(chain)
        self._curvatures = np.linspace(-tightest, tightest, 2 * _DESIGNS - 1)
        self._gains = np.array([_gain(chain, curvature) for curvature in self._curvatures])

    def steer(self, last: Pose2, articulation: FloatArray, on: ReferencePoint) -> float:
        """Demanded angle of the tractor's front wheels [rad], within their limit.

        ``last`` is the pose of the last axle, ``articulation`` (N,) [rad], ``on`` the nearest point of the reference.
        """
        gain = self.gain(on.curvature)
        x, y, psi = on.pose
        offset = math.cos(psi) * (last.y - y) - math.sin(psi) * (last.x - x)
        farthest = _STEEPEST * abs(gain[1] / gain[0])  # offset that demands the steepest approach [m]
        heading = math.remainder(last.psi - psi, math.tau)
        error = np.concatenate([[min(max(offset, -farthest), farthest), heading], articulation - on.articulation])
        curvature = on.tractor_curvature - float(gain @ error)
        limit = self._chain.max_steer
        return min(max(math.atan(self._chain.wheelbase * curvature), -limit), limit)

    def gain(self, curvature: float) -> FloatArray:
        """Gains (2 + N,) of lateral, heading and articulation errors on the tractor's curvature."""
        return np.array([np.interp(curvature, self._curvatures, column) for column in self._gains.T])


def _tightest(chain: RollingChain) -> float:
    """Largest curvature of the last axle's path [1/m] in a steady turn, with margin in steering and articulation."""
    for curvature in np.linspace(0.5, 0.01, 50).tolist():
        articulation, of_tractor = chain.steady(curvature)
        steer = math.atan(chain.wheelbase * of_tractor)
        if steer < 0.9 * chain.max_steer and np.abs(articulation).max() < _MOST_FOLDED:
            return float(curvature)
    return 0.01


def _gain(chain: RollingChain, curvature: float) -> FloatArray:
    """Gains (2 + N,) about the steady turn of a curvature [1/m]."""
    articulation, of_tractor = chain.steady(curvature)
    rest = np.concatenate([[0.0, 0.0], articulation])

    def rate(errors: FloatArray, steering: float) -> FloatArray:
        return _backward_rate(chain, rest + errors, of_tractor + steering, curvature)

    n, h = len(rest), _DIFFERENCE
    A = np.column_stack([(rate(h * e, 0.0) - rate(-h * e, 0.0)) / (2.0 * h) for e in np.eye(n)])
    B = (rate(np.zeros(n), h) - rate(np.zeros(n), -h))[:, None] / (2.0 * h)
    Q, R = np.zeros((n, n)), np.array([[1.0 / _CURVATURE**2]])
    Q[0, 0] = 1.0 / _LATERAL_ERROR**2
    P = scipy.linalg.solve_continuous_are(A, B, Q, R)
    gain: FloatArray = np.linalg.solve(R, B.T @ P)[0]
    return gain


def _backward_rate(chain: RollingChain, state: FloatArray, of_tractor: float, curvature: float) -> FloatArray:
    """Rates of lateral error, heading error and articulation per metre that the last axle moves back."""
    offset, heading, articulation = state[0], state[1], state[2:]
    speeds, yaw_rates = chain.rates(articulation, of_tractor)
    on_path = speeds[-1] * math.cos(heading) / (1.0 - curvature * offset)
    forward = [speeds[-1] * math.sin(heading), yaw_rates[-1] - curvature * on_path, *-np.diff(yaw_rates)]
    rates: FloatArray = -np.array(forward) / speeds[-1]
    return rates
