"""The shapes of a drive: swept area, road, paths, and the vehicle at some places."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from scenarios.drawings import shapes
from scenarios.drawings.shapes import Drawing, Shape, unit_layer
from scenarios.results.swept_path import UnitOutline, placed, placed_wheels
from vehicle.frames import FloatArray
from vehicle.polyline import arc_length, rows_every, sides
from vehicle.user_file import shown

EVERY: Final = 5.0  # distance between the drawn places of the vehicle, by default [m]
_STEP: Final = 0.1  # of travel between points of paths [m]
_TURN: Final = math.radians(0.5)  # of a body between the places that make up the swept area: 0.1 mm on a 12.5 m arc
_STRAIGHT: Final = 2.0  # of travel between them without turning [m]: less than the shortest body
_LONGEST: Final = 200e3  # distance driven [m]; beyond it a file is no run of this program
_PLACES: Final = 5000  # of the vehicle: more make a file that CAD programs hardly open
_SMOOTH: Final = 1e-3  # points of the swept area's edge closer than this to a straight line are left out [m]
_LINE: Final = 300  # characters of a note
_HINT: Final = "drawings need {}; install it with: pip install 'offtrack[cad]'"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrivenPath:
    """Content of the drawing of a drive."""

    title: str
    notes: tuple[str, ...]
    units: tuple[UnitOutline, ...]  # tractor first
    poses: tuple[FloatArray, ...]  # x, y [m], psi [rad] of each unit over time, (n, 3)
    steer: tuple[FloatArray, ...]  # angle of each axle of each unit over time, (n, n_axles) [rad]
    time: FloatArray  # (n,) [s]
    front_axle_x: float  # foremost steered axle of the tractor [m]
    course: FloatArray | None = None  # (m, 2) path of the guided point [m]
    road: FloatArray | None = None  # (m, 2) middle of the road [m]
    road_half_width: float | FloatArray = math.nan  # everywhere, or (m, 2) to both sides [m]


def drawing(driven: DrivenPath, *, every: float = EVERY) -> Drawing:
    """The drawing of a drive with the vehicle every ``every`` [m] of travel, and where it ends.

    Raises:
        ValueError: one line, if the vehicle did not move, or an optional package is missing.
    """
    if not all(np.isfinite(poses).all() for poses in driven.poses):
        raise ValueError("there is nothing to draw: a position is not a number")
    travelled = float(arc_length(driven.poses[0][:, :2])[-1]) if len(driven.time) > 1 else 0.0
    if not _STEP <= travelled <= _LONGEST:
        limits = f"must be {_STEP:g} m to {1e-3 * _LONGEST:g} km"
        raise ValueError(f"there is nothing to draw: the vehicle drove {travelled:.3g} m, {limits}")
    if travelled / every > _PLACES:
        raise ValueError(f"the vehicle every {every:g} m would be {travelled / every:.0f} times, at most {_PLACES}")
    version = importlib.metadata.version("offtrack")
    frame = "metres; x along the first heading, y to the left, origin at the tractor's rear axle at the start"
    return Drawing(
        title=shown(driven.title, _LINE),
        notes=tuple(shown(line, _LINE) for line in (*driven.notes, f"Frame: {frame}", f"offtrack {version}")),
        shapes=tuple(_shapes(driven, every)),
    )


def _shapes(driven: DrivenPath, every: float) -> Iterator[Shape]:
    if driven.road is not None and np.isfinite(driven.road_half_width).all():
        yield from _areas(_road_area(driven.road, driven.road_half_width), shapes.ROAD)
        yield Shape(layer=shapes.ROAD_CENTRE, points=driven.road, closed=False)
    yield from _areas(_swept_area(driven), shapes.SWEPT)
    if driven.course is not None:
        yield Shape(layer=shapes.COURSE, points=driven.course, closed=False)
    rows = rows_every(driven.poses[0][:, :2], _STEP)
    for layer, unit, x in (
        (shapes.FRONT_AXLE, 0, driven.front_axle_x),
        (shapes.LAST_AXLE, len(driven.units) - 1, min(driven.units[-1].axles)),
    ):
        path = placed(np.array([[x, 0.0]]), driven.poses[unit][rows])[:, 0]
        yield Shape(layer=layer, points=path, closed=False)
    yield from _vehicles(driven, every)


def _vehicles(driven: DrivenPath, every: float) -> Iterator[Shape]:
    """Closed outlines of all bodies and wheels at some places."""
    along = arc_length(driven.poses[0][:, :2])
    places = [*np.arange(0.0, along[-1], every).tolist(), float(along[-1])]
    rows = np.unique(np.minimum(np.searchsorted(along, places), len(along) - 1))
    for row in rows.tolist():
        seen = {"time_s": float(driven.time[row]), "travelled_m": float(along[row])}
        for unit, poses, steer in zip(driven.units, driven.poses, driven.steer, strict=True):
            (body,) = placed(unit.corners, poses[[row]])
            properties: dict[str, str | float] = {"unit": unit.name, **seen}
            yield Shape(layer=unit_layer(unit.name), points=body[::-1], closed=True, properties=properties)
            for wheel in placed_wheels(unit, poses[[row]], steer[[row]])[0]:
                yield Shape(layer=shapes.WHEELS, points=wheel[::-1], closed=True, properties=properties)


def _swept_area(driven: DrivenPath) -> Any:
    """Union of each body at close places, and of the triangles from its middle to each step of its corners.

    Between two places the sides of a body leave out the square of its turning, the corners nothing but the sagitta.
    """
    shapely = _shapely()
    parts = []
    for unit, poses in zip(driven.units, driven.poses, strict=True):
        corners = placed(unit.corners, poses[_moved(poses)])  # (n, 4, 2)
        middle = np.broadcast_to(corners[:-1].mean(axis=1, keepdims=True), corners[:-1].shape)
        steps = np.stack([middle, corners[:-1], corners[1:]], axis=2)  # (n - 1, 4, 3, 2)
        parts += [shapely.polygons(corners), shapely.polygons(steps.reshape(-1, 3, 2))]
    return shapely.union_all(np.concatenate(parts)).simplify(_SMOOTH)


def _moved(poses: FloatArray) -> FloatArray:
    """Rows between which a body moves or turns by about a step; first and last included."""
    yaw = np.unwrap(poses[:, 2])
    turned = np.abs(np.diff(yaw, prepend=yaw[0]))
    moved = np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T)
    steps = np.cumsum(moved / _STRAIGHT + turned / _TURN)
    rows: FloatArray = np.unique(np.append(np.searchsorted(steps, np.arange(0.0, steps[-1])), len(poses) - 1))
    return rows


def _road_area(centre: FloatArray, half_width: float | FloatArray) -> Any:
    if isinstance(half_width, np.ndarray):
        left, right = sides(centre, half_width)
        pieces = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)
        return _shapely().union_all(_shapely().convex_hull(_shapely().polygons(pieces))).simplify(_SMOOTH)
    return _shapely().LineString(centre).buffer(half_width, cap_style="flat").simplify(_SMOOTH)


def _areas(area: Any, layer: str) -> Iterator[Shape]:
    """A shape for each part of an area."""
    for part in _shapely().get_parts(area):
        whole = _shapely().geometry.polygon.orient(part)
        edge, *holes = (np.array(ring.coords, dtype=np.float64)[:-1] for ring in (whole.exterior, *whole.interiors))
        yield Shape(layer=layer, points=edge, closed=True, holes=tuple(holes))


def _shapely() -> Any:
    try:
        import shapely
    except ImportError as error:
        raise ValueError(_HINT.format("shapely")) from error
    return shapely


def missing_package(names: Sequence[str]) -> str | None:
    """A line on the first of these packages that is not installed; None if all are."""
    missing = next((name for name in names if importlib.util.find_spec(name) is None), None)
    return None if missing is None else _HINT.format(missing)
