"""Fit a path of continuous curvature through the points of a file, and check it.

The fit minimises the integral of d^2 + (l / 2 pi)^6 (d kappa / d s)^2 over the path. d is the lateral distance of the
points, weighted by their spacing. Of a wave in the points it keeps the share 1 / (1 + (l / wavelength)^6): bends much
shorter than the smoothing length l are removed as noise, much longer ones are kept. Lines and arcs are not changed.
Where the curvature of the points jumps, the path has a ramp of about half the smoothing length.

The path is a chain of clothoids between knots. Each Gauss-Newton step shifts it sideways by eta(s), which changes its
curvature by eta'' + kappa^2 eta; the normal equations have seven diagonals, so that the time is linear in the length.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import scipy

from controllers.path import Path, Segment
from scenarios.roads.path_file import PathPoints
from vehicle.frames import FloatArray, Pose2, arc_length, quadrature

_KNOTS: Final = 16  # per smoothing length: linear interpolation between them errs by 0.6 % of a wave of that length
_MOST_KNOTS: Final = 60_000  # of a path: a second to fit
_FEWEST_KNOTS: Final = 12
_ITERATIONS: Final = 40  # usual are 4 to 10
_CONVERGED: Final = 1e-6  # largest shift of the last step [m]
_NODES, _WEIGHTS = quadrature(6)  # to rounding for turns of up to 0.3 rad between knots
_LONG_LEG: Final = 5.0  # a leg so many times as long as the shorter of its neighbours is a straight line
_PROJECTIONS: Final = 4  # Newton steps: the first of them is within a millimetre

_NO_PATH: Final = "no smooth path leads through the points: they turn back, jump to and fro, or are too few"


class SmoothPath(NamedTuple):
    """A path fitted to points."""

    path: Path  # in the frame of the points
    stations: FloatArray  # (n,) of the points along the path [m]
    deviations: FloatArray  # (n,) of the points from the path [m], + left


class _Chain(NamedTuple):
    """Clothoids of one length between knots."""

    start: Pose2
    step: float  # [m]
    curvature: FloatArray  # (n + 1,) at the knots [1/m]

    def knots(self) -> tuple[FloatArray, FloatArray]:
        """Positions (n + 1, 2) [m] and headings (n + 1,) [rad] of the knots."""
        k = self.curvature
        headings = self.start.psi + np.concatenate([[0.0], np.cumsum(0.5 * self.step * (k[1:] + k[:-1]))])
        moves = _moves(headings[:-1], k[:-1], np.diff(k) / self.step, np.full(len(k) - 1, self.step))
        places = np.array(self.start[:2]) + np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
        return places, headings

    def path(self) -> Path:
        """The chain as a path."""
        return Path(self.start, tuple(Segment(self.step, *ends) for ends in pairwise(self.curvature.tolist())))


def smooth_path(points: FloatArray, smoothing: float) -> SmoothPath:
    """The path of continuous curvature through points (n, 2) [m], with a smoothing length [m].

    Raises:
        ValueError: one line, if no path can be fitted: the points turn back, or jump to and fro.
    """
    targets = _with_straights(points, smoothing)
    along = arc_length(targets)
    weights = np.minimum(np.gradient(along), smoothing)  # [m]; lone points count as far as they can be heard
    chain = _first_guess(targets, along, weights, smoothing)
    stations = along
    for _ in range(_ITERATIONS):
        stations, deviations = _projected(chain, targets, stations)
        shift = _shift(chain, stations, deviations, weights, smoothing)
        chain = _shifted(chain, shift, float(stations[0]), float(stations[-1]))
        stations = stations - stations[0]
        if float(np.abs(shift).max()) < _CONVERGED:
            stations, deviations = _projected(chain, points, np.interp(arc_length(points), along, stations))
            return SmoothPath(chain.path(), stations, deviations)
    raise ValueError(_NO_PATH)


def smooth_values(stations: FloatArray, values: FloatArray, at: FloatArray, smoothing: float) -> FloatArray:
    """Values (n,) at ``stations`` (n,) [m], smoothed as a path is, at equidistant stations ``at`` (m,) [m]."""
    if len(at) < _FEWEST_KNOTS or not np.ptp(values):
        return np.interp(at, stations, values)
    weights = np.minimum(np.gradient(stations), smoothing)
    return _smoothed(stations - at[0], values[:, None], weights, float(at[1] - at[0]), len(at), smoothing)[:, 0]


def _with_straights(points: FloatArray, smoothing: float) -> FloatArray:
    """The points, with further ones on legs that are much longer than their neighbours, or that are alone.

    A line that was drawn of straight lines and arcs has many points on its arcs and none on its straights.
    """
    legs = np.hypot(*np.diff(points, axis=0).T)
    neighbours = np.minimum(np.append(legs[1:], np.inf), np.insert(legs[:-1], 0, np.inf))
    usual = np.where(np.isfinite(neighbours), neighbours, smoothing)
    pieces = np.where(
        (legs > _LONG_LEG * usual) | ~np.isfinite(neighbours), np.ceil(legs / np.maximum(usual, 0.25 * smoothing)), 1.0
    ).astype(int)
    rows = np.concatenate([[0.0], np.repeat(np.arange(len(legs)), pieces) + _fractions(pieces)])
    return np.stack([np.interp(rows, np.arange(len(points)), points[:, i]) for i in range(2)], axis=1)


def _fractions(pieces: np.ndarray[tuple[int, ...], np.dtype[np.int_]]) -> FloatArray:
    """For each leg of so many pieces the ends of its pieces, as shares of the leg."""
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    return (np.arange(pieces.sum()) - first + 1.0) / np.repeat(pieces, pieces)


def _first_guess(targets: FloatArray, along: FloatArray, weights: FloatArray, smoothing: float) -> _Chain:
    """A chain near the targets: both coordinates smoothed alone, and the curvature of the polygon between the knots."""
    length = float(along[-1])
    count = int(np.clip(math.ceil(_KNOTS * length / smoothing), _FEWEST_KNOTS, _MOST_KNOTS))
    knots = _smoothed(along, targets, weights, length / count, count + 1, smoothing)
    legs = np.diff(knots, axis=0)
    headings = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    step = float(np.hypot(*legs.T).mean())
    curvature = np.diff(headings) / step
    curvature = np.concatenate([curvature[:1], curvature, curvature[-1:]])
    start = Pose2(float(knots[0, 0]), float(knots[0, 1]), float(headings[0] - 0.5 * step * curvature[0]))
    return _Chain(start, step, curvature)


def _smoothed(
    along: FloatArray, values: FloatArray, weights: FloatArray, step: float, count: int, smoothing: float
) -> FloatArray:
    """Values (n, m) at distances ``along`` (n,), smoothed, at ``count`` knots a ``step`` apart (count, m)."""
    third = scipy.sparse.diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(count - 3, count)) / step**3
    at = _interpolation(along / step, count)
    return _solved(at, third, weights, values, np.zeros((count - 3, values.shape[1])), step, smoothing)


def _shift(
    chain: _Chain, stations: FloatArray, deviations: FloatArray, weights: FloatArray, smoothing: float
) -> FloatArray:
    """Lateral shift of the chain at its knots, and one knot beyond each end (n + 3,) [m]."""
    step, k = chain.step, chain.curvature
    count = len(k) + 2
    bend: Any = scipy.sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(len(k), count)) / step**2
    bend = bend + scipy.sparse.diags_array(k**2, offsets=1, shape=(len(k), count))  # the change of curvature
    change = scipy.sparse.diags_array([-1.0, 1.0], offsets=[0, 1], shape=(len(k) - 1, len(k))) / step
    at = _interpolation(stations / step + 1.0, count)
    rough = change @ bend
    return _solved(at, rough, weights, deviations[:, None], -np.diff(k)[:, None] / step, step, smoothing)[:, 0]


def _solved(
    at: "scipy.sparse.csr_array",
    rough: Any,  # a sparse array of any format
    weights: FloatArray,
    values: FloatArray,
    wanted: FloatArray,
    step: float,
    smoothing: float,
) -> FloatArray:
    """Least squares: ``at @ x`` near the values, ``rough @ x`` near what is wanted."""
    penalty = step * (smoothing / math.tau) ** 6
    weighted = at.T @ scipy.sparse.diags_array(weights)
    matrix = scipy.sparse.csr_array(weighted @ at + penalty * (rough.T @ rough))
    bands = np.zeros((4, matrix.shape[0]))
    for k in range(4):
        bands[k, : matrix.shape[0] - k] = matrix.diagonal(k)
    try:
        wanted = weighted @ values + penalty * (rough.T @ wanted)
        solution: FloatArray = scipy.linalg.solveh_banded(bands, wanted, lower=True)
    except np.linalg.LinAlgError:
        raise ValueError(_NO_PATH) from None
    return solution


def _interpolation(rows: FloatArray, count: int) -> "scipy.sparse.csr_array":
    """Matrix (n, count) that interpolates linearly at fractional rows (n,), and extrapolates beyond the ends."""
    below = np.clip(rows.astype(np.intp), 0, count - 2)
    share = rows - below
    n = np.arange(len(rows))
    return scipy.sparse.csr_array(
        (np.concatenate([1.0 - share, share]), (np.tile(n, 2), np.concatenate([below, below + 1]))),
        shape=(len(rows), count),
    )


def _projected(chain: _Chain, points: FloatArray, near: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stations of the points (n,) near given ones, and their distances from the chain [m], + left."""
    places, headings = chain.knots()
    k, stations = chain.curvature, near
    for step in range(_PROJECTIONS + 1):
        below = np.clip((stations / chain.step).astype(np.intp), 0, len(k) - 2)
        u = stations - below * chain.step
        sharpness = (k[below + 1] - k[below]) / chain.step
        inside = np.clip(u, 0.0, chain.step)
        heading = headings[below] + inside * (k[below] + 0.5 * sharpness * inside)
        c, s = np.cos(heading), np.sin(heading)
        moved = _moves(headings[below], k[below], sharpness, inside) + (u - inside)[:, None] * np.stack([c, s], axis=1)
        x, y = (points - places[below] - moved).T
        across = c * y - s * x
        if step == _PROJECTIONS:
            break
        curvature = k[below] + sharpness * inside
        stations = stations + (c * x + s * y) / np.maximum(1.0 - curvature * across, 0.5)
    return stations, across


def _moves(headings: FloatArray, curvature: FloatArray, sharpness: FloatArray, u: FloatArray) -> FloatArray:
    """Movement (n, 2) [m] over the distances u (n,) [m] of clothoids with these values at their start."""
    distances = u[:, None] * _NODES
    angles = headings[:, None] + distances * (curvature[:, None] + 0.5 * sharpness[:, None] * distances)
    return u[:, None] * np.stack([np.cos(angles) @ _WEIGHTS, np.sin(angles) @ _WEIGHTS], axis=1)


def _shifted(chain: _Chain, shift: FloatArray, begin: float, end: float) -> _Chain:
    """The chain shifted sideways, from the station ``begin`` to ``end`` [m]."""
    step, k = chain.step, chain.curvature
    curvature = k + np.diff(shift, 2) / step**2 + k**2 * shift[1:-1]
    x, y, psi = chain.start
    x, y = x - shift[1] * math.sin(psi), y + shift[1] * math.cos(psi)
    psi += float(shift[2] - shift[0]) / (2.0 * step)
    start = Pose2(x + begin * math.cos(psi), y + begin * math.sin(psi), psi + begin * float(curvature[0]))
    stretch = 1.0 - k * shift[1:-1]  # of lengths, by the shift to the side
    knots = np.concatenate([[0.0], np.cumsum(0.5 * step * (stretch[1:] + stretch[:-1]))])
    ratio = float(knots[-1]) / (step * (len(k) - 1))
    stations = np.linspace(ratio * begin, ratio * end, len(k))
    return _Chain(start, ratio * (end - begin) / (len(k) - 1), np.interp(stations, knots, curvature))


_THIN: Final = 1.0 / 20.0  # points closer than this share of the smoothing length are averaged
_BACK: Final = 2.0  # turn between two legs that is a way back, not a bend [rad]
_LONGEST_LEG: Final = 250.0  # between two points [m]: a longer one is a gap in the file
_BOW: Final = 1.0 / 8.0  # largest distance of the path from a leg between two points, as a share of the smoothing
_LONGEST: Final = 50e3  # course [m]: five hours at 10 km/h, and some seconds to build


@dataclass(frozen=True, slots=True)
class Fit:
    """How a path is fitted to points."""

    source: str  # file, for messages
    smoothing: float  # length [m]
    tolerance: float  # largest distance of a point from the path [m]
    shortest: float  # path that makes sense [m]
    least: float = math.inf  # length to which the smoothing may be shortened where it leaves the tolerance [m]


def fitted_path(points: PathPoints, fit: Fit) -> tuple[SmoothPath, PathPoints]:
    """The path through the points, and the points that it was fitted to.

    Raises:
        ValueError: one line with the place, if there is no such path within the tolerance.
    """
    shorter, refused = fit, list[ValueError]()
    while shorter.smoothing >= min(fit.least, fit.smoothing):
        try:
            smooth, thin = _fitted(points, shorter)
        except ValueError as error:
            refused.append(error)
            shorter = replace(shorter, smoothing=0.5 * shorter.smoothing)
        else:
            said = f"course.file: its bends need course.smoothing = {shorter.smoothing:g} m, which was taken"
            return smooth, replace(thin, remarks=(*thin.remarks, said)) if refused else thin
    raise refused[0]


def _fitted(points: PathPoints, fit: Fit) -> tuple[SmoothPath, PathPoints]:
    """The path of one smoothing length."""
    places = points.places
    length = float(arc_length(places)[-1])
    if not fit.shortest <= length <= _LONGEST:
        raise ValueError(
            f"{fit.source}: the path is {length:.4g} m long: must be {fit.shortest:g} m to {1e-3 * _LONGEST:g} km "
            "(x and y are metres; columns lat and lon, GPX and GeoJSON have degrees)"
        )
    thin = _thinned(points, _THIN * fit.smoothing)
    _check_legs(thin, fit)
    try:
        smooth = smooth_path(thin.places - places[0], fit.smoothing)
    except ValueError as error:
        raise ValueError(f"{fit.source}: {error} (course.smoothing = {fit.smoothing:g} m)") from None
    worst = int(np.argmax(np.abs(smooth.deviations)))
    if not abs(smooth.deviations[worst]) <= fit.tolerance:
        raise ValueError(
            f"{fit.source}: the smooth path is {abs(smooth.deviations[worst]):.3g} m from "
            f"{thin.named(worst)}: must be within course.tolerance = {fit.tolerance:g} m; a shorter "
            f"course.smoothing than {fit.smoothing:g} m keeps sharper bends, a larger tolerance allows for noisy points"
        )
    _check_bows(smooth, thin, fit)
    return smooth, thin


def stretch(points: PathPoints, begin: float, length: float | None, source: str) -> PathPoints:
    """The points from a distance ``begin`` [m] along them, over a ``length`` [m]; None: to their end.

    Raises:
        ValueError: one line, if the points end before.
    """
    along = arc_length(points.places)
    end = math.inf if length is None else begin + length
    rows = (along >= begin) & (along <= end)
    if np.count_nonzero(rows) < 2:
        raise ValueError(
            f"{source}: the path is {along[-1]:.4g} m long: course.begin = {begin:g} m leaves nothing of it"
        )
    return points.changed(lambda values: values[rows])


def _thinned(points: PathPoints, spacing: float) -> PathPoints:
    """The points, averaged over pieces of ``spacing`` [m] where they are closer; both ends stay where they are."""
    along = arc_length(points.places)
    if np.diff(along).min() >= spacing:
        return points
    kept = (along >= 0.5 * spacing) & (along <= along[-1] - 0.5 * spacing)
    group = np.floor(along / spacing).astype(np.int64)
    group[0], group[-1] = -1, group[-1] + 1
    kept[0] = kept[-1] = True
    _, rows = np.unique(group[kept], return_inverse=True)

    def averaged(values: FloatArray) -> FloatArray:
        columns = [np.bincount(rows, column) / np.bincount(rows) for column in values[kept].reshape(len(rows), -1).T]
        return np.stack(columns, axis=1).reshape(-1, *values.shape[1:])

    return points.changed(averaged)


def _check_legs(points: PathPoints, fit: Fit) -> None:
    """Refuse gaps and ways back."""
    legs = np.diff(points.places, axis=0)
    lengths = np.hypot(*legs.T)
    longest = int(np.argmax(lengths))
    if lengths[longest] > _LONGEST_LEG:
        raise ValueError(
            f"{fit.source}: a gap of {lengths[longest]:.4g} m between {points.named(longest)} and "
            f"{points.named(longest + 1)}: must be at most {_LONGEST_LEG:g} m; add the missing points"
        )
    heading = np.arctan2(legs[:, 1], legs[:, 0])
    turns = np.abs(np.remainder(np.diff(heading) + math.pi, math.tau) - math.pi)
    if len(turns) and turns.max() > _BACK:
        place = points.named(int(np.argmax(turns)) + 1)
        raise ValueError(
            f"{fit.source}: the path turns back by {math.degrees(turns.max()):.0f} deg at {place}: no vehicle "
            "drives that; give the points in the order of driving, or a longer course.smoothing"
        )


def _check_bows(smooth: SmoothPath, points: PathPoints, fit: Fit) -> None:
    """Refuse points too far apart to know the path between them."""
    places = points.places
    stations = np.array(smooth.path.stations)
    knots = np.array(smooth.path.knots)[:, :2] + places[0]
    leg = np.clip(np.searchsorted(smooth.stations, stations, side="right") - 1, 0, len(places) - 2)
    along = np.diff(places, axis=0)
    along /= np.hypot(*along.T)[:, None]
    away = knots - places[leg]
    bows = np.abs(along[leg, 0] * away[:, 1] - along[leg, 1] * away[:, 0])
    worst = int(np.argmax(bows))
    if not bows[worst] <= max(_BOW * fit.smoothing, fit.tolerance):
        k = int(leg[worst])
        raise ValueError(
            f"{fit.source}: the path bows {bows[worst]:.3g} m aside between {points.named(k)} and "
            f"{points.named(k + 1)}: they are too far apart to know it; add points between them"
        )


def near(points: PathPoints, smooth: SmoothPath, station: float) -> str:
    """The point of the file that is nearest to a station [m], for messages."""
    return f"near {points.named(int(np.argmin(np.abs(smooth.stations - station))))}"
