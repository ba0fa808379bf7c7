"""Writers of drawings: DXF for CAD, GeoJSON for GIS."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from scenarios.drawings import shapes
from scenarios.drawings.shapes import MEANINGS, UNIT_COLOURS, Drawing, Shape
from scenarios.results.files import replacing
from vehicle.frames import FloatArray

Format = Literal["dxf", "geojson"]
FORMATS: Final[tuple[Format, ...]] = ("dxf", "geojson")
PACKAGES: Final = {"dxf": ("shapely", "ezdxf"), "geojson": ("shapely",)}  # that a format needs

_METRES: Final = 6  # DXF's $INSUNITS
_DIGITS: Final = 4  # of coordinates in GeoJSON: a tenth of a millimetre
_TEXT: Final = 0.5  # height of the title's letters over which notes are smaller [m]


def write_drawing(drawing: Drawing, path: Path, kind: Format) -> None:
    """Write a drawing under a temporary name, and rename it."""
    with replacing(path) as unfinished:
        if kind == "dxf":
            _write_dxf(drawing, unfinished)
        else:
            text = json.dumps(geojson(drawing), allow_nan=False, indent=1, ensure_ascii=False)
            unfinished.write_text(text + "\n", encoding="utf-8")


def geojson(drawing: Drawing) -> dict[str, Any]:
    """A feature collection; coordinates are metres of the course's frame, not degrees."""
    return {
        "type": "FeatureCollection",
        "name": drawing.title,
        "notes": list(drawing.notes),
        "coordinate_frame": "local frame of the course in metres, not WGS 84",
        "features": [_feature(shape) for shape in drawing.shapes],
    }


def _feature(shape: Shape) -> dict[str, Any]:
    if shape.closed:
        rings = [_ring(points) for points in (shape.points, *shape.holes)]
        geometry: dict[str, Any] = {"type": "Polygon", "coordinates": rings}
    else:
        geometry = {"type": "LineString", "coordinates": _rounded(shape.points)}
    numbers = {
        key: round(one, _DIGITS) if isinstance(one, float) else one for key, one in dict(shape.properties).items()
    }
    return {"type": "Feature", "properties": {"layer": shape.layer, **numbers}, "geometry": geometry}


def _ring(points: FloatArray) -> list[list[float]]:
    return _rounded(np.concatenate([points, points[:1]]))


def _rounded(points: FloatArray) -> list[list[float]]:
    rounded: list[list[float]] = np.round(points, _DIGITS).tolist()
    return rounded


def _write_dxf(drawing: Drawing, path: Path) -> None:
    """A DXF file of release 2010 in metres: a layer for each kind of shape, closed polylines for areas."""
    import ezdxf

    fixed = ezdxf.options.write_fixed_meta_data_for_testing
    try:  # no times and random identifiers: the same run gives the same file
        ezdxf.options.write_fixed_meta_data_for_testing = True
        _document(drawing).saveas(path)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = fixed


def _document(drawing: Drawing) -> Any:
    import ezdxf
    import ezdxf.zoom

    document = ezdxf.new("R2010", units=_METRES)
    header = document.header
    header["$MEASUREMENT"], header["$LUNITS"], header["$LUPREC"] = 1, 2, 3  # metric, decimal, millimetres
    units = [name for name in drawing.layers if name not in MEANINGS]
    for name in (*drawing.layers, shapes.NOTES):
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
        text = space.add_text(line, height=_TEXT, dxfattribs={"layer": shapes.NOTES})
        text.set_placement((float(corner[0]), float(corner[1]) - 2.0 * _TEXT * (k + 2)))
    ezdxf.zoom.extents(space)
    return document


def formats_of(choice: str) -> tuple[Format, ...]:
    """The formats of ``dxf``, ``geojson`` or ``both``."""
    return tuple(kind for kind in FORMATS if choice in (kind, "both"))


def needed_packages(kinds: Sequence[Format]) -> tuple[str, ...]:
    """Packages that writing these formats needs."""
    return tuple(dict.fromkeys(name for kind in kinds for name in PACKAGES[kind]))
