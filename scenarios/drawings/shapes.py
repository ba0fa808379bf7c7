"""Contents of a drawing: polylines and areas on layers, independent of the file format.

Coordinates are those of the course in metres: x along the tractor's first heading, y to the left, origin at its rear
axle at the start.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from vehicle.frames import FloatArray

SWEPT, ROAD, ROAD_CENTRE, COURSE, FRONT_AXLE, LAST_AXLE, WHEELS, NOTES = (
    "SWEPT_PATH",
    "ROAD_EDGE",
    "ROAD_CENTRE",
    "COURSE",
    "PATH_FRONT_AXLE",
    "PATH_LAST_AXLE",
    "WHEELS",
    "NOTES",
)
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
_NOT_IN_NAMES: Final = re.compile(r"[^A-Z0-9_-]+")


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
    shapes: tuple[Shape, ...]

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of the layers that hold a shape."""
        return tuple(dict.fromkeys(shape.layer for shape in self.shapes))


def unit_layer(unit: str) -> str:
    """Layer of a unit's outlines: VEHICLE_ and its name in letters that every CAD program takes."""
    return f"VEHICLE_{_NOT_IN_NAMES.sub('_', unit.upper())}"
