"""Positions on the earth as metres in a plane, and the coordinate systems that files of tracks may name."""

import re
from typing import Final, NamedTuple

import numpy as np

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


class Utm(NamedTuple):
    """A zone of the universal transverse Mercator projection."""

    zone: int  # 1 to 60
    south: bool = False  # northings count from 10 000 km south of the equator

    @property
    def code(self) -> str:
        """Its name, on WGS 84."""
        return f"EPSG:{(32700 if self.south else 32600) + self.zone}"


_SCALE: Final = 0.9996  # of UTM on its central meridian
_N: Final = _F / (2.0 - _F)  # third flattening; Krüger's series follow in its powers, to the fourth
_BETA: Final = (
    _N / 2 - 2 * _N**2 / 3 + 37 * _N**3 / 96 - _N**4 / 360,
    _N**2 / 48 + _N**3 / 15 - 437 * _N**4 / 1440,
    17 * _N**3 / 480 - 37 * _N**4 / 840,
    4397 * _N**4 / 161280,
)
_DELTA: Final = (
    2 * _N - 2 * _N**2 / 3 - 2 * _N**3 + 116 * _N**4 / 45,
    7 * _N**2 / 3 - 8 * _N**3 / 5 - 227 * _N**4 / 45,
    56 * _N**3 / 15 - 136 * _N**4 / 35,
    4279 * _N**4 / 630,
)


def from_utm(utm: Utm, easting: FloatArray, northing: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Latitudes and longitudes [deg] of eastings and northings [m]; eastings may begin with the number of the zone."""
    radius = _SCALE * _A / (1.0 + _N) * (1.0 + _N**2 / 4 + _N**4 / 64)
    easting = np.where(easting >= 1e6, easting - 1e6 * utm.zone, easting) - 500e3
    along, across = (northing - 10e6 * utm.south) / radius, easting / radius
    xi = along - sum(b * np.sin(k * along) * np.cosh(k * across) for k, b in zip((2, 4, 6, 8), _BETA, strict=True))
    eta = across - sum(b * np.cos(k * along) * np.sinh(k * across) for k, b in zip((2, 4, 6, 8), _BETA, strict=True))
    conformal = np.arcsin(np.sin(xi) / np.cosh(eta))
    latitude = conformal + sum(d * np.sin(k * conformal) for k, d in zip((2, 4, 6, 8), _DELTA, strict=True))
    return np.degrees(latitude), np.degrees(np.arctan2(np.sinh(eta), np.cos(xi))) + 6.0 * utm.zone - 183.0


_DEGREES: Final = frozenset((4326, 4979, 4258, 4937, 4269, 4617, 4283, 7844, 6668))  # WGS 84 and frames like it
_ZONES: Final = {  # first and last code, number of the first zone, and hemisphere
    (32601, 32660): Utm(1),
    (32701, 32760): Utm(1, south=True),
    (25828, 25838): Utm(28),  # ETRS 89
    (3040, 3051): Utm(28),  # ETRS 89, northing first on paper
    (26901, 26923): Utm(1),  # NAD 83
    (28346, 28358): Utm(46, south=True),  # GDA 94
    (7846, 7859): Utm(46, south=True),  # GDA 2020
    (4647, 4647): Utm(32),  # ETRS 89, eastings begin with the zone
    (5650, 5650): Utm(33),
    (3006, 3006): Utm(33),  # SWEREF 99 TM
    (3067, 3067): Utm(35),  # ETRS-TM35FIN
}
_OTHERS: Final = {
    3857: "Web Mercator", 900913: "Web Mercator", 27700: "British National Grid", 2154: "Lambert-93",
    28992: "RD New", 2056: "Swiss LV95", 21781: "Swiss LV03", 31467: "Gauss-Krüger zone 3", 3035: "ETRS 89 LAEA",
}  # fmt: skip


def coordinate_system(name: str) -> Utm | None:
    """The zone of UTM that a coordinate system's name or EPSG code stands for; None: degrees of longitude and latitude.

    Raises:
        ValueError: the rest of a line that says what is wrong, for any other system.
    """
    code = re.search(r"EPSG(?:[:/][\d.]*)*[:/](\d+)$", name.strip(), re.IGNORECASE)
    zone = re.search(r"UTM zone (\d{1,2}) ?([NS])", name, re.IGNORECASE)
    if zone and 1 <= int(zone[1]) <= 60:
        return Utm(int(zone[1]), zone[2].upper() == "S")
    number = int(code[1]) if code and len(code[1]) < 10 else 0
    if number in _DEGREES or re.search(r"CRS:?84h?$|^WGS[ _]?(19)?84$", name.strip(), re.IGNORECASE):
        return None
    for (first, last), utm in _ZONES.items():
        if first <= number <= last:
            return utm._replace(zone=utm.zone + number - first)
    known = f" ({_OTHERS[number]})" if number in _OTHERS else ""
    raise ValueError(
        f"its coordinate system is {f'EPSG:{number}' if number else shown(repr(name), 80)}{known}: must be in degrees "
        "(EPSG:4326) or UTM (EPSG:326xx, 327xx, 258xx); save it with EPSG:4326 (QGIS: Export, Save Features As; "
        "ogr2ogr -t_srs EPSG:4326)"
    )
