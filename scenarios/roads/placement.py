"""Where the world of a course lies in the coordinates of its file, and in those of the earth."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from scenarios.extras import import_extra
from scenarios.roads.earth import EarthPlane
from vehicle.foundation.user_file import shown
from vehicle.frames import FloatArray, Pose2

DEGREES: Final = "EPSG:4326"
_ENGINEERING: Final = (
    'ENGCRS["{0}",EDATUM["{0}"],CS[Cartesian,2],AXIS["{1}",unspecified,ORDER[1]],AXIS["{2}",unspecified,ORDER[2]],'
    'LENGTHUNIT["metre",1]]'
)
_OF_HEIGHTS: Final = re.compile(r"\s*\+(geoidgrids|vunits|vto_meter)=\S+")  # drawings have none


class Coordinates(NamedTuple):
    """Coordinates of a drawing."""

    crs: str  # their system: a code, a PROJ text or WKT
    words: str  # what they are
    of: Callable[[FloatArray], FloatArray]  # coordinates of places (n, 2) in W [m]
    digits: int = 4  # that tell places a tenth of a millimetre apart


WORLD: Final = Coordinates(
    _ENGINEERING.format("Frame of the course", "along the first heading", "to the left"),
    "metres; x along the first heading, y to the left, origin at the tractor's rear axle at the start",
    lambda points: points,
)


_SAME: Final = Pose2(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """Pose of W in the plane of a file's points, and what is known of that plane."""

    X_FW: Pose2 = _SAME  # [m, rad]
    crs: str = ""  # of the file: a code or a PROJ text; empty: it names none
    plane: EarthPlane | None = None  # that the points were projected on; None: they are as in the file

    def in_file(self, points: FloatArray) -> FloatArray:
        """Places (n, 2) in W [m] as metres of the file, or as longitudes and latitudes [deg]."""
        places = self.X_FW.apply(points)
        return places if self.plane is None else self.plane.degrees(places)

    def record(self) -> dict[str, str | float]:
        """Origin and first heading of W in the coordinates of the file, and what these are."""
        degrees = self.plane is not None
        names = ("origin_longitude_deg", "origin_latitude_deg") if degrees else ("origin_x_m", "origin_y_m")
        origin = zip(names, self.in_file(np.zeros((1, 2)))[0].tolist(), strict=True)
        numbers = {**dict(origin), "first_heading_deg": math.degrees(self.X_FW.psi)}
        crs = DEGREES if degrees else self.crs
        return {**({"crs": crs} if crs else {}), **{name: round(value, 9) for name, value in numbers.items()}}

    def coordinates(self, crs: str | None, *, metres: bool) -> Coordinates:
        """Coordinates of a drawing in a system, by default in that of the file.

        Args:
            crs: name of the system; a file of metres that names none is taken to be in it.
            metres: True if degrees will not do.

        Raises:
            ValueError: one line, if the system is not known or has degrees, or an optional package is missing.
        """
        own, target = DEGREES if self.plane else self.crs, crs or self.crs
        if self.plane and metres and target == DEGREES and crs is None:
            longitude, latitude = self.plane.degrees(np.zeros((1, 2)))[0].tolist()
            words = (
                f"metres east (x) and north (y) on the plane that touches the earth at {latitude:.7f}, {longitude:.7f}"
            )
            return Coordinates(_ENGINEERING.format("Tangent plane", "east", "north"), words, self.X_FW.apply)
        if not target:
            named = _ENGINEERING.format("Frame of the course's file", "x", "y")
            return Coordinates(named, "metres; x and y of the course's file", self.in_file)
        if target == own == DEGREES and not metres:
            return Coordinates(DEGREES, "longitude and latitude, degrees of WGS 84", self.in_file, 9)
        if target == own and crs is None:
            return Coordinates(own, f"metres; x and y of the course's file: {own}", self.in_file)
        return _other_system(self.in_file, own, target, metres=metres)


UNPLACED: Final = Placement()  # metres as in a file that names no system


def _other_system(in_file: Callable[[FloatArray], FloatArray], own: str, target: str, *, metres: bool) -> Coordinates:
    """Coordinates in a system by pyproj; those of a file that names no system are taken to be in it."""
    pyproj = import_extra("gis", f"--crs {shown(target, 60)}: needs", "pyproj")
    try:
        system = pyproj.CRS.from_user_input(_OF_HEIGHTS.sub("", target))
        moved = pyproj.Transformer.from_crs(_OF_HEIGHTS.sub("", own), system, always_xy=True) if own else None
    except pyproj.exceptions.ProjError as error:
        line = " ".join(str(error).split())
        raise ValueError(f"--crs {shown(target, 60)}: no coordinate system that is known: {shown(line, 120)}") from None
    if system.is_geographic and (metres or not own):
        needs = "DXF needs metres" if metres else "the course's file has metres"
        raise ValueError(
            f"--crs {shown(target, 60)}: has degrees; {needs}, such as those of a zone of UTM (EPSG:25832)"
        )

    def of(points: FloatArray) -> FloatArray:
        return in_file(points) if moved is None else np.stack(moved.transform(*in_file(points).T), axis=1)

    return Coordinates(target, f"{system.name} ({target})", of, 9 if system.is_geographic else 4)
