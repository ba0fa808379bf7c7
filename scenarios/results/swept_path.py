"""Swept path of a combination: outlines of its bodies, swept width, tail swing, and distance to road edges.

Bodies are rectangles on the ground plane. Poses are arrays (n, 3) of x [m], y [m], psi [rad] over time; psi may be
wrapped or continuous.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from scenarios.results.log import Log
from vehicle.frames import FloatArray, arc_length, rows_every

_QUARTER_TURN = 0.5 * math.pi
_TURN = math.radians(10.0)  # a smaller change of heading is a lane change, not a turn
_OTHER_WAY = math.radians(20.0)  # a steered trailer that swings out points less far to the other side
_STATION_SPACING = 0.25  # [m] between the cross-sections in which the width is measured
_ROW_SPACING = 0.1  # [m] of travel between the outlines used; the path in between is almost straight


class TurnArc(NamedTuple):
    """A turn of constant curvature."""

    centre: tuple[float, float]  # [m]
    start: float  # heading where it begins [rad]
    turn: float  # change of heading, + left [rad]


@dataclass(frozen=True, slots=True)
class UnitOutline:
    """Plan view of one unit: positions along x in the unit's own frame, forward positive."""

    name: str
    front_x: float  # [m]
    rear_x: float  # [m]
    width: float  # [m]
    axles: tuple[float, ...]  # x of each axle [m]
    tracks: tuple[float, ...]  # of each axle, between the wheels' middles [m]
    steer_signals: tuple[str | None, ...] = ()  # signal of each axle's steer angle; None: it is not steered

    @property
    def corners(self) -> FloatArray:
        """Front left, front right, rear right, rear left corner in the unit's frame, shape (4, 2) [m]."""
        half = 0.5 * self.width
        return np.array([[self.front_x, half], [self.front_x, -half], [self.rear_x, -half], [self.rear_x, half]])

    @property
    def pose_signals(self) -> tuple[str, str, str]:
        """Names of the signals of its pose."""
        return f"x_{self.name}", f"y_{self.name}", f"psi_{self.name}"

    def poses(self, log: Log) -> FloatArray:
        """x [m], y [m], psi [rad] of its frame over time, (n_rows, 3)."""
        return np.column_stack([log[name] for name in self.pose_signals])

    def axle_steer(self, log: Log) -> FloatArray:
        """Steer angle of each axle over time, (n_rows, n_axles) [rad]; zero where the log has none."""
        zero = np.zeros(len(log))
        angles = [log[name] if name and name in log else zero for name in self.steer_signals]
        return np.nan_to_num(np.column_stack(angles))


def placed(points: FloatArray, poses: FloatArray) -> FloatArray:
    """Points (m, 2) of a body in the world, shape (n, m, 2), for poses (n, 3)."""
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x = poses[:, 0, None] + c * points[:, 0] - s * points[:, 1]
    y = poses[:, 1, None] + s * points[:, 0] + c * points[:, 1]
    return np.stack([x, y], axis=-1)


@dataclass(frozen=True, slots=True)
class SweptPath:
    """Space used by a run; NaN for what does not apply to its course."""

    max_width: float  # [m]
    min_inner_radius: float  # about the centre of the turn [m]
    max_outer_radius: float  # [m]
    tail_swing_entry: float  # at the entry of the first turn [m]
    tail_swing_exit: float  # at the exit of the last turn [m]

    @property
    def tail_swing(self) -> float:
        """Larger tail swing of entry and exit [m]."""
        return float(np.fmax(self.tail_swing_entry, self.tail_swing_exit))


def swept_path(
    outlines: tuple[UnitOutline, ...],
    poses: tuple[FloatArray, ...],
    circle_centre: tuple[float, float] | None,
    arcs: Sequence[TurnArc] = (),
) -> SweptPath:
    """Swept path of the combination whose units have these outlines and poses; unit 0 is the tractor.

    On a roundabout the width is the outer minus the inner radius; elsewhere see :func:`width_across_path`, and the
    inner radius is that of the ``arcs``.
    """
    swings = tail_swings(outlines, poses)
    if circle_centre is None:
        return SweptPath(width_across_path(outlines, poses), inner_radius(outlines, poses, arcs), math.nan, *swings)
    inner, outer = swept_radii(outlines, poses, circle_centre)
    return SweptPath(outer - inner, inner, outer, *swings)


def swept_radii(
    outlines: tuple[UnitOutline, ...], poses: tuple[FloatArray, ...], centre: tuple[float, float]
) -> tuple[float, float]:
    """Smallest and largest distance [m] of any body from the centre of the roundabout; NaN without a turn.

    Only the sector of the roundabout counts. It begins at the radius square to the tractor's first heading, where the
    straight entry touches the circle, and ends at the radius square to its last heading, where the exit leaves it.
    """
    yaw = np.unwrap(poses[0][:, 2])
    if abs(yaw[-1] - yaw[0]) < _TURN:
        return math.nan, math.nan
    side = float(np.sign(yaw[-1] - yaw[0]))
    entry = yaw[0] - side * _QUARTER_TURN
    inner, outer = [math.inf], [-math.inf]
    for outline, pose in zip(outlines, poses, strict=True):
        nearest = _nearest_points(outline, pose, centre)
        corners = placed(outline.corners, pose)
        middle = placed(np.array([[0.5 * (outline.front_x + outline.rear_x), 0.0]]), pose)
        for points, radii in ((nearest, inner), (corners, outer)):
            angle = side * (_polar_angle(points, middle, centre, entry) - entry)
            on_circle = (angle >= 0.0) & (angle <= abs(yaw[-1] - yaw[0]))
            radius = np.hypot(points[..., 0] - centre[0], points[..., 1] - centre[1])[on_circle]
            radii.extend((float(radius.min()), float(radius.max())) if radius.size else ())
    return (min(inner), max(outer)) if len(inner) > 1 and len(outer) > 1 else (math.nan, math.nan)


def inner_radius(outlines: Sequence[UnitOutline], poses: Sequence[FloatArray], arcs: Sequence[TurnArc]) -> float:
    """Smallest distance [m] of any body from the centre of the turn that it drives; NaN without a turn.

    ``arcs`` are the turns of the guided point's path. Of each turn the sector counts in which the path bends.
    """
    smallest = math.inf
    for centre, start, turn in arcs:
        side = math.copysign(1.0, turn)
        entry = start - side * _QUARTER_TURN  # direction from the centre to the arc's beginning
        for outline, pose in zip(outlines, poses, strict=True):
            away = _nearest_points(outline, pose, centre)[:, 0] - np.array(centre)
            angle = np.mod(side * (np.arctan2(away[:, 1], away[:, 0]) - entry), 2.0 * math.pi)
            radius = np.hypot(*away[angle <= abs(turn)].T)
            smallest = min(smallest, float(radius.min(initial=math.inf)))
    return smallest if math.isfinite(smallest) else math.nan


def _nearest_points(outline: UnitOutline, poses: FloatArray, centre: tuple[float, float]) -> FloatArray:
    """The point of a body nearest to the centre, in the world, shape (n, 1, 2)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy = centre[0] - poses[:, 0], centre[1] - poses[:, 1]
    x = np.clip(c * dx + s * dy, outline.rear_x, outline.front_x)
    y = np.clip(-s * dx + c * dy, -0.5 * outline.width, 0.5 * outline.width)
    nearest: FloatArray = np.stack([poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y], axis=-1)[:, None, :]
    return nearest


def _polar_angle(points: FloatArray, middle: FloatArray, centre: tuple[float, float], start: float) -> FloatArray:
    """Continuous angle of points (n, m, 2) about the centre; it begins within half a turn of ``start``."""

    def angle(p: FloatArray) -> FloatArray:
        polar: FloatArray = np.arctan2(p[..., 1] - centre[1], p[..., 0] - centre[0])
        return polar

    body = np.unwrap(angle(middle), axis=0)
    body = body - 2.0 * math.pi * np.round((body[0] - start) / (2.0 * math.pi))
    offset = angle(points) - body
    counted: FloatArray = body + offset - 2.0 * math.pi * np.round(offset / (2.0 * math.pi))
    return counted


def width_across_path(outlines: tuple[UnitOutline, ...], poses: tuple[FloatArray, ...]) -> float:
    """Largest width [m] swept by all bodies, measured square to the path of the middle of the tractor's front.

    Cross-sections stand on that path; each one collects the strips that the bodies cut out of it from the moment the
    front arrives until the combination has passed. A long combination in a hairpin cuts the section's line a
    second time, on the other leg: the section ends at the centre of the path's curvature, and strips count as far as
    they hang together with that of the front. NaN if the vehicle hardly moved.
    """
    front = placed(np.array([[outlines[0].front_x, 0.0]]), poses[0])[:, 0]
    along = arc_length(front)
    rows = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], _ROW_SPACING)))
    if along[-1] < 2.0 * _STATION_SPACING:
        return math.nan
    front, along = front[rows], along[rows]
    corners = [placed(outline.corners, pose[rows]).T.copy() for outline, pose in zip(outlines, poses, strict=True)]
    length = max(float(np.hypot(*(of_body[:, :, 0] - front[0][:, None])).max()) for of_body in corners)
    stations = np.arange(0.0, along[-1], _STATION_SPACING)
    tangents = np.gradient(front, along, axis=0)
    at = [np.interp(stations, along, part) for part in (*front.T, *tangents.T, _curvature(tangents, along))]
    widths = [0.0]
    for s, (*place, bend) in zip(stations, np.column_stack(at), strict=True):
        point, tangent = np.array(place[:2]), np.array(place[2:])
        # On a path that crosses itself the section must not see the vehicle pass on another leg: it has passed when
        # the front has gone on by the combination's length, or on an arc of up to half a turn, pi / 2 times that.
        first, last = np.searchsorted(along, [s, s + _QUARTER_TURN * length])
        strips = np.concatenate([_strips(c[:, :, first:last], point, tangent / np.hypot(*tangent)) for c in corners])
        centre = 1.0 / bend if bend else math.inf
        widths.append(_width_round(0.0, np.minimum(strips, centre) if centre > 0.0 else np.maximum(strips, centre)))
    return max(widths)


def _curvature(tangents: FloatArray, along: FloatArray) -> FloatArray:
    """Mean curvature [1/m], + left, of a path over a metre on either side of its points, from their tangents (n, 2)."""
    heading = np.unwrap(np.arctan2(tangents[:, 1], tangents[:, 0]))
    before, after = (np.clip(along + side, along[0], along[-1]) for side in (-1.0, 1.0))
    mean: FloatArray = (np.interp(after, along, heading) - np.interp(before, along, heading)) / (after - before)
    return mean


def _strips(corners: FloatArray, point: FloatArray, tangent: FloatArray) -> FloatArray:
    """Strips (m, 2) that a body cuts out of the line through a point square to the tangent [m], + left.

    The corners (2, 4, n) over time give a strip for each time and the next: of the edges at the first of them, and of
    the corners' paths in between.
    """
    (x, y), (t_x, t_y) = corners - point[:, None, None], tangent
    along, lateral = x * t_x + y * t_y, y * t_x - x * t_y
    behind = along <= 0.0
    cut = behind.any(axis=0) & ~behind.all(axis=0)
    cut[:-1] |= (behind[:, 1:] != behind[:, :-1]).any(axis=0)
    rows = np.flatnonzero(cut)
    after, of_rows = np.minimum(rows + 1, x.shape[1] - 1), (along[:, rows], lateral[:, rows])
    edges = _crossings(*of_rows, *(of_all[[1, 2, 3, 0]] for of_all in of_rows))
    cuts = np.concatenate([edges, _crossings(*of_rows, along[:, after], lateral[:, after])])
    return np.column_stack([np.fmin.reduce(cuts), np.fmax.reduce(cuts)])


def _crossings(along: FloatArray, lateral: FloatArray, next_along: FloatArray, next_lateral: FloatArray) -> FloatArray:
    """Lateral position of each segment from one point to the next where it passes along = 0; NaN if it does not."""
    cut = (along <= 0.0) != (next_along <= 0.0)
    share = along / np.where(cut, along - next_along, 1.0)
    crossing: FloatArray = np.where(cut, lateral + share * (next_lateral - lateral), np.nan)
    return crossing


def _width_round(place: float, strips: FloatArray) -> float:
    """Width [m] of the strips (m, 2) [m] that hang together with the one at a place or nearest to it; 0 of none."""
    if not len(strips):
        return 0.0
    strips = strips[np.argsort(strips[:, 0])]
    right_edge = np.maximum.accumulate(strips[:, 1])
    begins = np.flatnonzero(np.concatenate([[True], strips[1:, 0] > right_edge[:-1]]))
    low, high = strips[begins, 0], right_edge[np.append(begins[1:], len(strips)) - 1]
    nearest = int(np.argmin(np.maximum(np.maximum(low - place, place - high), 0.0)))
    return float(high[nearest] - low[nearest])


def tail_swings(outlines: Sequence[UnitOutline], poses: Sequence[FloatArray]) -> tuple[float, float]:
    """Tail swing at the entry of the first turn and at the exit of the last [m]; NaN without a turn.

    At entry: the largest distance of a unit's outer rear corner beyond the line along the outer side of that unit as
    it stood straight behind the tractor's first pose, until the unit has turned 90 degrees, or it or the tractor has
    turned back to its first heading. At exit the same backward in time, with the tractor's last pose. The entry value
    is the low-speed tail swing of performance-based standards; the exit matters for steered trailers.
    """
    entry, leaving = (
        [
            swing
            for outline, pose in zip(outlines, poses, strict=True)
            if (swing := _swing_out(outline, pose[::direction], poses[0][::direction], direction)) is not None
        ]
        for direction in (1, -1)  # forward in time from the entry; backward from the exit
    )
    return max(0.0, *entry) if entry else math.nan, max(0.0, *leaving) if leaving else math.nan


def _swing_out(outline: UnitOutline, poses: FloatArray, tractor: FloatArray, direction: int) -> float | None:
    """Largest distance of the outer rear corner beyond the straight on which the tractor stands in the first row.

    ``direction`` is -1 where the rows run backwards in time and a left turn thus decreases the yaw.
    """
    heading = float(tractor[0, 2])
    turned = np.unwrap(tractor[:, 2]) - heading
    bends = np.abs(turned) > _TURN
    if not bends.any():
        return None
    side = float(np.sign(turned[np.argmax(bends)]))
    outside = -direction * side  # + when it is on the left
    corner = placed(np.array([[outline.rear_x, outside * 0.5 * outline.width]]), poses)[:, 0]
    from_line = (corner - tractor[0, :2]) @ np.array([-math.sin(heading), math.cos(heading)])
    unit_turned = np.unwrap(poses[:, 2] - heading)
    unit_turned -= 2.0 * math.pi * np.round(unit_turned[0] / (2.0 * math.pi))
    over = np.abs(unit_turned) > _QUARTER_TURN
    over |= _turned_back(side * turned) | _turned_back(side * unit_turned)
    until = int(np.argmax(over)) if over.any() else len(poses)
    return float(np.max(outside * from_line[:until]) - 0.5 * outline.width) if until else None


def placed_wheels(outline: UnitOutline, poses: FloatArray, steer: FloatArray) -> FloatArray:
    """Rectangles of a unit's wheels in the world, shape (n, 2 n_axles, 4, 2), for steer (n, n_axles) [rad]."""
    tyre = np.array([[0.5, 0.17], [0.5, -0.17], [-0.5, -0.17], [-0.5, 0.17]])  # a 385/65 R 22.5, for drawings only
    rectangles = []
    for k, (x, track) in enumerate(zip(outline.axles, outline.tracks, strict=True)):
        for side in (0.5, -0.5):
            middle = placed(np.array([[x, side * track]]), poses)[:, 0]
            rectangles.append(placed(tyre, np.column_stack([middle, poses[:, 2] + steer[:, k]])))
    return np.stack(rectangles, axis=1)


def _turned_back(turned: FloatArray) -> NDArray[np.bool_]:
    """Rows in which a unit is turned to the negative side: plainly, or after it had turned to the positive one."""
    has_turned = np.logical_or.accumulate(turned > _TURN)
    back: NDArray[np.bool_] = (turned < -_OTHER_WAY) | (has_turned & (turned < 0.0))
    return back


_SPACING = 0.1  # of travel between the poses used; a wheel beside it is 0.1 mm further out at most, on 12 m [m]

_ROUNDING = 1e-6  # far more than that of a distance [m]


class RoadEdges:
    """Edges of a road, from the widths at the points of its centre line."""

    def __init__(self, road: FloatArray, half_width: float | FloatArray) -> None:
        """Create it from a centre line (n, 2) [m] with points no farther apart than the road is wide.

        Its half width is one number, or (n, 2) to the left and right of the points of the line [m].
        """
        self._line, self._half_width = scipy.spatial.KDTree(road), half_width
        self._narrowest = float(np.min(half_width))
        along = np.gradient(road, axis=0)
        gaps = np.hypot(*along.T)[:, None]
        self._along, self._half_gap = along / np.maximum(gaps, 1e-12), 0.5 * float(gaps.max())

    def distance(self, places: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Distance (m,) of places (m, 2) [m] inside the nearer edge, negative beyond it, and which are on the left."""
        nearest = np.asarray(self._line.query(places)[1], dtype=np.intp)
        away, along = places - self._line.data[nearest], self._along[nearest]
        lateral = along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0]
        past = np.maximum(np.abs(np.einsum("ij,ij->i", along, away)) - self._half_gap, 0.0)  # beyond an end of the road
        widths = np.broadcast_to(self._half_width, (len(self._along), 2))[nearest]
        inside: FloatArray = np.where(lateral > 0.0, *widths.T) - np.hypot(lateral, past)
        return inside, lateral > 0.0

    def room(self, places: FloatArray) -> float:
        """Distance [m] by which all places (m, 2) [m] may move and stay inside; negative: unknown.

        A place is inside while the nearest point of the line is less than the narrowest half width away, and that
        distance changes by no more than the place moves.
        """
        return self._narrowest - float(np.max(self._line.query(places)[0])) - _ROUNDING


class Clearance(NamedTuple):
    """Distance of the nearest wheel's middle, or of the nearest point of a body, inside the edges; negative: beyond.

    It is known in rows about 0.1 m of travel apart, and NaN in the others and where nothing is on that side.
    """

    distance: FloatArray  # (n, 2) over time, to the left and to the right edge [m]
    place: FloatArray  # (n, 2, 2) of that wheel or point [m]

    def least(self, side: int) -> int | None:
        """Row of the least distance to the left (0) or right (1) edge; None if it is known nowhere."""
        column = self.distance[:, side]
        return int(np.nanargmin(column)) if np.isfinite(column).any() else None


def wheel_clearance(edges: RoadEdges, outlines: Sequence[UnitOutline], poses: Sequence[FloatArray]) -> Clearance:
    """Clearance of all wheels of a combination that drives through ``poses``, one (n, 3) for each unit.

    A wheel on the left of the road's centre line counts for the left edge, one on the right for the right edge.
    """
    wheels = [
        np.array([(x, side * track) for x, track in zip(one.axles, one.tracks, strict=True) for side in (0.5, -0.5)])
        for one in outlines
    ]
    return _clearance(edges, wheels, poses)


def body_clearance(edges: RoadEdges, outlines: Sequence[UnitOutline], poses: Sequence[FloatArray]) -> Clearance:
    """Clearance of the swept path: of the corners of all bodies, and of their sides beside the axles.

    A body that follows without steered axles reaches farthest to the inside of a turn beside its axles.
    """
    sides = [np.array([(x, side * one.width) for x in one.axles for side in (0.5, -0.5)]) for one in outlines]
    bodies = [np.concatenate([one.corners, side]) for one, side in zip(outlines, sides, strict=True)]
    return _clearance(edges, bodies, poses)


def _clearance(edges: RoadEdges, points: Sequence[FloatArray], poses: Sequence[FloatArray]) -> Clearance:
    """Clearance of points (m, 2) of each unit."""
    count = len(poses[0])
    distance, place = np.full((count, 2), np.inf), np.full((count, 2, 2), np.nan)
    known = np.flatnonzero(np.isfinite(np.hstack(poses)).all(axis=1))  # a run that diverged ends with rows that are not
    rows = known[rows_every(poses[0][known, :2], _SPACING)]
    for own, driven in zip(points, poses, strict=True):
        at = placed(own, driven[rows])
        inside, on_left = (one.reshape(at.shape[:2]) for one in edges.distance(at.reshape(-1, 2)))
        for side, on_side in enumerate((on_left, np.logical_not(on_left))):
            away = np.where(on_side, inside, np.inf)
            nearest = (np.arange(len(rows)), away.argmin(axis=1))
            nearer = away[nearest] < distance[rows, side]
            distance[rows[nearer], side] = away[nearest][nearer]
            place[rows[nearer], side] = at[nearest][nearer]
    distance[~np.isfinite(distance)] = np.nan
    return Clearance(distance, place)
