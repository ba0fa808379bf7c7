"""Drawings of drives for CAD (DXF) and GIS (GeoJSON).

Coordinates are those of the course's file, or of a system that is asked for. Without a file they are metres: x along
the tractor's first heading, y to the left, origin at its rear axle at the start.
"""

import importlib.metadata
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from offtrack.exchange.exports.catalogue import plain_names
from scenarios.assembly.adapters import course_of, outlines, plant_vehicle, vehicle_of
from scenarios.extras import check_extra, import_extra
from scenarios.options.scenario import Scenario, load_any_scenario, of_kind
from scenarios.results.log import read_log
from scenarios.results.run_directory import replacing
from scenarios.results.swept_path import UnitOutline, placed, placed_wheels
from scenarios.roads.placement import DEGREES, WORLD, Coordinates, Placement
from vehicle.foundation.user_file import FileKind, read_json, shown
from vehicle.frames import FloatArray, arc_length, rows_every, sides

SWEPT, ROAD, ROAD_CENTRE, COURSE = "SWEPT_PATH", "ROAD_EDGE", "ROAD_CENTRE", "COURSE"
FRONT_AXLE, LAST_AXLE, WHEELS, NOTES = "PATH_FRONT_AXLE", "PATH_LAST_AXLE", "WHEELS", "NOTES"
MEANINGS: Final[Mapping[str, tuple[int, str]]] = {  # colour by AutoCAD's index, and what the layer holds
    SWEPT: (1, "area that all bodies sweep"),
    ROAD: (8, "edges of the road"),
    ROAD_CENTRE: (9, "middle of the road"),
    COURSE: (30, "prescribed path of the guided point"),
    FRONT_AXLE: (5, "path of the middle of the foremost steered axle"),
    LAST_AXLE: (3, "path of the middle of the last axle"),
    WHEELS: (7, "wheels of the vehicle at some places"),
    NOTES: (7, "title and notes"),
}
UNIT_COLOURS: Final = (4, 6, 2, 140)  # of the layers of the units, tractor first


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shape:
    """A polyline, or an area with its holes."""

    layer: str
    points: FloatArray  # (n, 2) [m]; of an area counter-clockwise, the first point is not repeated
    closed: bool
    holes: tuple[FloatArray, ...] = ()  # (m, 2) each, clockwise [m]
    properties: Mapping[str, str | float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawing:
    """Shapes on layers, with a title and notes."""

    title: str
    notes: tuple[str, ...]
    shapes: tuple[Shape, ...]  # in W
    placement: Placement | None = None  # of W in the course's file; None: there is none

    def placed(self, crs: str | None, *, metres: bool) -> tuple["Drawing", Coordinates]:
        """The drawing in a system of coordinates, by default that of the file, as ``Placement.coordinates``."""
        if crs is not None and self.placement is None:
            raise ValueError(
                f"--crs {shown(crs, 60)}: the course comes from no file: its place on the earth is unknown"
            )
        coordinates = WORLD if self.placement is None else self.placement.coordinates(crs, metres=metres)
        shapes = tuple(
            replace(shape, points=coordinates.of(shape.points), holes=tuple(map(coordinates.of, shape.holes)))
            for shape in self.shapes
        )
        record = () if self.placement is None else (f"Placement: {json.dumps(self.placement.record())}",)
        notes = (*self.notes, *(shown(line, _LINE) for line in (f"Coordinates: {coordinates.words}", *record)))
        return replace(self, shapes=shapes, notes=notes), coordinates

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of the layers that hold a shape."""
        return tuple(dict.fromkeys(shape.layer for shape in self.shapes))


def unit_layers(units: Iterable[str]) -> dict[str, str]:
    """Layers of units' outlines: VEHICLE_ and a name in letters that every CAD program takes, each its own."""
    return {unit: f"VEHICLE_{layer}" for unit, layer in plain_names(units, case=str.upper).items()}


EVERY: Final = 5.0  # distance between the drawn places of the vehicle, by default [m]
_STEP: Final = 0.1  # of travel between points of paths [m]
_TURN: Final = math.radians(0.5)  # of a body between the places that make up the swept area: 0.1 mm on a 12.5 m arc
_STRAIGHT: Final = 2.0  # of travel between them without turning [m]: less than the shortest body
_LONGEST: Final = 200e3  # distance driven [m]; beyond it a file is no run of this program
_PLACES: Final = 5000  # of the vehicle: more make a file that CAD programs hardly open
_SMOOTH: Final = 1e-3  # points of the swept area's edge closer than this to a straight line are left out [m]
_LINE: Final = 300  # characters of a note


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
    placement: Placement | None = None  # of W in the course's file; None: there is none


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
    return Drawing(
        title=shown(driven.title, _LINE),
        notes=tuple(shown(line, _LINE) for line in (*driven.notes, f"offtrack {version}")),
        shapes=tuple(_shapes(driven, every)),
        placement=driven.placement,
    )


def _shapes(driven: DrivenPath, every: float) -> Iterator[Shape]:
    if driven.road is not None and np.isfinite(driven.road_half_width).all():
        yield from _areas(_road_area(driven.road, driven.road_half_width), ROAD)
        yield Shape(layer=ROAD_CENTRE, points=driven.road, closed=False)
    yield from _areas(_swept_area(driven), SWEPT)
    if driven.course is not None:
        yield Shape(layer=COURSE, points=driven.course, closed=False)
    rows = rows_every(driven.poses[0][:, :2], _STEP)
    for layer, unit, x in (
        (FRONT_AXLE, 0, driven.front_axle_x),
        (LAST_AXLE, len(driven.units) - 1, min(driven.units[-1].axles)),
    ):
        path = placed(np.array([[x, 0.0]]), driven.poses[unit][rows])[:, 0]
        yield Shape(layer=layer, points=path, closed=False)
    yield from _vehicles(driven, every)


def _vehicles(driven: DrivenPath, every: float) -> Iterator[Shape]:
    """Closed outlines of all bodies and wheels at some places."""
    along = arc_length(driven.poses[0][:, :2])
    places = [*np.arange(0.0, along[-1], every).tolist(), float(along[-1])]
    rows = np.unique(np.minimum(np.searchsorted(along, places), len(along) - 1))
    layers = unit_layers([unit.name for unit in driven.units])
    for row in rows.tolist():
        seen = {"time_s": float(driven.time[row]), "travelled_m": float(along[row])}
        for unit, poses, steer in zip(driven.units, driven.poses, driven.steer, strict=True):
            (body,) = placed(unit.corners, poses[[row]])
            properties: dict[str, str | float] = {"unit": unit.name, **seen}
            yield Shape(layer=layers[unit.name], points=body[::-1], closed=True, properties=properties)
            for wheel in placed_wheels(unit, poses[[row]], steer[[row]])[0]:
                yield Shape(layer=WHEELS, points=wheel[::-1], closed=True, properties=properties)


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
    return import_extra("cad", "drawings need", "shapely")


def driven_run(directory: Path) -> DrivenPath:
    """The drive of a trailer's run.

    Raises:
        ValueError: one line, if this is no run directory of a trailer, or its files can not be read.
    """
    if not (directory / "scenario.toml").is_file():
        raise ValueError(f"{shown(str(directory))}: is no run directory: it has no scenario.toml")
    scenario = of_kind(
        load_any_scenario(str(directory / "scenario.toml")),
        Scenario,
        f"{shown(str(directory))}: is a rover's run: only runs of trailers are drawn",
    )
    nominal = vehicle_of(scenario)
    vehicle, course = plant_vehicle(scenario), course_of(scenario, nominal)
    log, units = read_log(directory / "signals.parquet"), outlines(vehicle)
    needed = ("time", *(name for unit in units for name in unit.pose_signals))
    missing = [name for name in needed if name not in log]
    if missing:
        raise ValueError(f"{directory / 'signals.parquet'}: has no signal {shown(missing[0])}")
    outcome, seed = (_told(directory / "summary.json", key) for key in ("outcome", "seed"))
    return DrivenPath(
        title=f"{scenario.name}: {vehicle.name}",
        notes=(f"outcome: {outcome}, seed {seed}, {scenario.speed_kmh:g} km/h",),
        units=units,
        poses=tuple(unit.poses(log) for unit in units),
        steer=tuple(unit.axle_steer(log) for unit in units),
        time=log["time"],
        front_axle_x=vehicle.units[0].steered_axles[0].x,
        course=course.path.points(0.25),
        road=course.centreline,
        road_half_width=course.road_half_width,
        placement=course.placement if isinstance(course.placement, Placement) else None,
    )


def _told(path: Path, key: str) -> Any:
    """An entry of a run's summary; a dash if there is none."""
    try:
        return read_json(path, FileKind.RECORD).get(key, "–")
    except ValueError:
        return "–"


_METRES: Final = 6  # DXF's $INSUNITS
_DIGITS: Final = 4  # of times and distances
_SCALES: Final = (50, 100, 200, 250, 500, 1000, 2000, 2500, 5000, 10_000, 20_000, 50_000, 100_000, 1_000_000)
_PAPER: Final = np.array([0.42, 0.297])  # A3 [m]
_MARGIN: Final = 0.01  # of the paper [m]
_TEXT: Final = 0.5  # height of the title's letters over which notes are smaller [m]


def write_drawing(drawing: Drawing, path: Path, kind: str, crs: str | None = None) -> None:
    """Write a drawing in a format of ``FORMATS`` under a temporary name, and rename it.

    Raises:
        ValueError: one line, if the coordinate system does not fit.
    """
    with replacing(path) as unfinished:
        FORMATS[kind](drawing, unfinished, crs)


def _write_geojson(drawing: Drawing, path: Path, crs: str | None) -> None:
    text = json.dumps(geojson(drawing, crs), allow_nan=False, indent=1, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def geojson(drawing: Drawing, crs: str | None = None) -> dict[str, Any]:
    """A feature collection; coordinates that are no degrees of WGS 84 have a ``crs``, as GDAL and QGIS read it."""
    placed, coordinates = drawing.placed(crs, metres=False)
    named = {"crs": {"type": "name", "properties": {"name": coordinates.crs}}}
    return {
        "type": "FeatureCollection",
        "name": placed.title,
        "notes": list(placed.notes),
        **({} if coordinates.crs == DEGREES else named),
        **({"placement": placed.placement.record()} if placed.placement else {}),
        "features": [_feature(shape, coordinates.digits) for shape in placed.shapes],
    }


def _feature(shape: Shape, digits: int) -> dict[str, Any]:
    rings = [np.round(points, digits).tolist() for points in (shape.points, *shape.holes)]
    if shape.closed:
        geometry: dict[str, Any] = {"type": "Polygon", "coordinates": [[*ring, ring[0]] for ring in rings]}
    else:
        geometry = {"type": "LineString", "coordinates": rings[0]}
    numbers = {
        key: round(one, _DIGITS) if isinstance(one, float) else one for key, one in dict(shape.properties).items()
    }
    return {"type": "Feature", "properties": {"layer": shape.layer, **numbers}, "geometry": geometry}


def _write_dxf(drawing: Drawing, path: Path, crs: str | None) -> None:
    """A DXF file of release 2010 in metres: a layer for each kind of shape, closed polylines for areas."""
    ezdxf = import_extra("cad", "drawings need", "ezdxf")
    fixed = ezdxf.options.write_fixed_meta_data_for_testing
    try:  # no times and random identifiers: the same run gives the same file
        ezdxf.options.write_fixed_meta_data_for_testing = True
        _document(drawing.placed(crs, metres=True)[0]).saveas(path)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = fixed


def _document(drawing: Drawing) -> Any:
    ezdxf = import_extra("cad", "drawings need", "ezdxf", "ezdxf.zoom", "ezdxf.bbox")
    document = ezdxf.new("R2010", units=_METRES)
    header = document.header
    header["$MEASUREMENT"], header["$LUNITS"], header["$LUPREC"] = 1, 2, 3  # metric, decimal, millimetres
    units = [name for name in drawing.layers if name not in MEANINGS]
    for name in (*drawing.layers, NOTES):
        colour = UNIT_COLOURS[units.index(name) % len(UNIT_COLOURS)] if name in units else MEANINGS[name][0]
        meaning = "outlines of this unit at some places" if name in units else MEANINGS[name][1]
        layer = document.layers.add(name, color=colour)
        layer.description = meaning
    space = document.modelspace()
    for shape in drawing.shapes:
        for points in (shape.points, *shape.holes):
            space.add_lwpolyline(points.tolist(), close=shape.closed, dxfattribs={"layer": shape.layer})
    corner = np.min(np.concatenate([shape.points for shape in drawing.shapes]), axis=0)
    for k, line in enumerate((drawing.title, *drawing.notes)):
        text = space.add_text(line, height=_TEXT, dxfattribs={"layer": NOTES})
        text.set_placement((float(corner[0]), float(corner[1]) - 2.0 * _TEXT * (k + 2)))
    box = ezdxf.bbox.extents(space, fast=True)
    ezdxf.zoom.window(space, box.extmin, box.extmax)
    space.reset_extents(box.extmin, box.extmax)
    document.active_layout().reset_limits((0.0, 0.0), tuple(_PAPER.tolist()))  # in metres, as LibreCAD reads them
    low, size = np.array(box.extmin)[:2], np.array(box.size)[:2]
    scale = next((one for one in _SCALES if (size / one <= _PAPER - 2.0 * _MARGIN).all()), _SCALES[-1])
    header["$PSVPSCALE"], header["$PINSBASE"] = 1.0 / scale, (*(_MARGIN - low / scale).tolist(), 0.0)
    return document


FORMATS: Final[Mapping[str, Callable[[Drawing, Path, str | None], None]]] = {
    "dxf": _write_dxf,
    "geojson": _write_geojson,
}


def formats_of(choice: str) -> tuple[str, ...]:
    """The formats of a name in ``FORMATS``, or of ``both``; empty for ``none``.

    Raises:
        ValueError: one line, if a package that they need is not installed.
    """
    formats = tuple(kind for kind in FORMATS if choice in (kind, "both"))
    if formats:
        check_extra("cad", "drawings need", "shapely", *(("ezdxf",) if "dxf" in formats else ()))
    return formats
