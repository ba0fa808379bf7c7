"""Positions on the earth as metres in a plane, and the coordinate systems that files of tracks may name."""

import re
from typing import Final, NamedTuple

import numpy as np

from scenarios.extras import import_extra
from vehicle.foundation.user_file import shown
from vehicle.frames import FloatArray

_A: Final = 6_378_137.0  # semi-major axis of WGS 84 [m]; GRS 80 is the same within 0.1 mm
_F: Final = 1.0 / 298.257223563  # its flattening
_E2: Final = _F * (2.0 - _F)  # square of its eccentricity


class EarthPlane(NamedTuple):
    """A plane that touches the earth in the middle of some points, with axes east and north."""

    middle: FloatArray  # (3,) earth-centred [m]
    axes: FloatArray  # (3, 2) east and north
    height: float  # of the points above the ellipsoid [m]

    def degrees(self, places: FloatArray) -> FloatArray:
        """Longitudes and latitudes (n, 2) [deg] of places on the plane (n, 2) [m], which were projected on it."""
        up, above = np.cross(*self.axes.T), np.zeros((len(places), 1))
        for _ in range(3):  # by the curvature of the earth, a point is below the plane
            points = self.middle + places @ self.axes.T + above * up
            lat, lon, height = _geodetic(points)
            above = above - (height - self.height)[:, None]
        return np.degrees(np.stack([lon, lat], axis=1))


def tangent_plane(latitude: FloatArray, longitude: FloatArray, height: FloatArray) -> tuple[FloatArray, EarthPlane]:
    """Positions east and north (n, 2) [m] of points (n,) in degrees at heights above the ellipsoid [m], and the plane.

    At 10 km from the middle distances are 12 mm too short by the curvature of the earth.
    """
    places = _geocentric(np.radians(latitude), np.radians(longitude), height)
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    lon = np.arctan2(middle[1], middle[0])
    lat = _bowring(np.hypot(middle[0], middle[1]), middle[2])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    plane = EarthPlane(middle, np.stack([east, north], axis=1), float(height.mean()))
    return (places - middle) @ plane.axes, plane


def _bowring(across: FloatArray, z: FloatArray) -> FloatArray:
    """Bowring's first approximation of geodetic latitudes; near the ellipsoid it is right to 1e-9 rad."""
    beta = np.arctan2(z, (1.0 - _F) * across)
    lat: FloatArray = np.arctan2(
        z + _E2 / (1.0 - _E2) * (1.0 - _F) * _A * np.sin(beta) ** 3, across - _E2 * _A * np.cos(beta) ** 3
    )
    return lat


def _geodetic(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Latitudes and longitudes [rad] and heights [m] of earth-centred points (n, 3) [m]."""
    across, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    lat = _bowring(across, z)
    for _ in range(2):  # each leaves 0.7 % of the error
        sine = np.sin(lat)
        lat = np.arctan2(z + _E2 * _A * sine / np.sqrt(1.0 - _E2 * sine**2), across)
    height = across * np.cos(lat) + z * np.sin(lat) - _A * np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return lat, np.arctan2(points[:, 1], points[:, 0]), height


def _geocentric(lat: FloatArray, lon: FloatArray, height: FloatArray) -> FloatArray:
    """Earth-centred positions (n, 3) [m]."""
    n = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    across = (n + height) * np.cos(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), ((1.0 - _E2) * n + height) * np.sin(lat)], axis=1)


_BEYOND: Final = 6.0  # the area that a system is meant for [deg]: a neighbouring zone is good to centimetres
_DEGREES: Final = re.compile(  # WGS 84 and frames like it
    r"CRS:?84h?$|^WGS[ _]?(19)?84$|EPSG(?:[:/][\d.]*)*[:/](?:4326|4979|4258|4937|4269|4617|4283|7844|6668)$",
    re.IGNORECASE,
)


def coordinate_system(name: str) -> str | None:
    """The name of a system of metres, as the package pyproj knows it; None: degrees of longitude and latitude.

    Raises:
        ValueError: the rest of a line that says what is wrong, for any other system, or without that package.
    """
    if _DEGREES.search(name.strip()):
        return None
    pyproj = import_extra("gis", f"its coordinate system is {shown(repr(name), 80)}, which needs", "pyproj")
    try:
        system = pyproj.CRS.from_user_input(name.strip())
    except pyproj.exceptions.ProjError:
        system = None
    if not (system and system.is_projected and all(axis.unit_conversion_factor == 1.0 for axis in system.axis_info)):
        known = f" ({system.name})" if system else ""
        raise ValueError(
            f"its coordinate system is {shown(repr(name), 80)}{known}: must be in degrees (EPSG:4326) or metres, such "
            "as EPSG:25832; save it with EPSG:4326 (QGIS: Export, Save Features As; ogr2ogr -t_srs EPSG:4326)"
        )
    return name.strip()


def from_metres(system: str, easting: FloatArray, northing: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Latitudes and longitudes [deg] of eastings and northings [m].

    Raises:
        ValueError: the rest of a line, if they are outside of the area of the system.
    """
    pyproj = import_extra("gis", f"{shown(system, 80)} needs", "pyproj")
    transformer = pyproj.Transformer.from_crs(system, "EPSG:4326", always_xy=True)
    longitude, latitude = (np.asarray(one, dtype=np.float64) for one in transformer.transform(easting, northing))
    west, south, east, north = pyproj.CRS.from_user_input(system).area_of_use.bounds
    with np.errstate(invalid="ignore"):  # infinite ones
        beside = np.abs((longitude - 0.5 * (west + east) + 180.0) % 360.0 - 180.0) - 0.5 * (east - west)
    if not np.all((beside < _BEYOND) & (latitude > south - _BEYOND) & (latitude < north + _BEYOND)):
        raise ValueError(
            f"[{easting[0]:.2f}, {northing[0]:.2f}] is outside of the area of {shown(system, 80)}: are easting and "
            "northing in its order, without the number of a zone?"
        )
    return latitude, longitude
