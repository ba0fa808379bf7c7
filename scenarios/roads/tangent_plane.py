"""From latitude and longitude to the plane that touches the WGS 84 ellipsoid in the middle of the points."""

from __future__ import annotations

from typing import Final

import numpy as np

from vehicle.frames import FloatArray

_A: Final = 6_378_137.0  # semi-major axis of WGS 84 [m]
_F: Final = 1.0 / 298.257223563  # its flattening
_E2: Final = _F * (2.0 - _F)  # square of its eccentricity


def tangent_plane(latitude: FloatArray, longitude: FloatArray, height: FloatArray) -> FloatArray:
    """Positions east and north (n, 2) [m] of points (n,) in degrees at heights above the ellipsoid [m].

    At 10 km from the middle distances are 12 mm too short by the curvature of the earth.
    """
    places = _geocentric(np.radians(latitude), np.radians(longitude), height)
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    lon = np.arctan2(middle[1], middle[0])
    # Bowring's first approximation of the geodetic latitude; near the ellipsoid it is right to 1e-9 rad.
    across = np.hypot(middle[0], middle[1])
    beta = np.arctan2(middle[2], (1.0 - _F) * across)
    lat = np.arctan2(
        middle[2] + _E2 / (1.0 - _E2) * (1.0 - _F) * _A * np.sin(beta) ** 3, across - _E2 * _A * np.cos(beta) ** 3
    )
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    plane: FloatArray = (places - middle) @ np.stack([east, north], axis=1)
    return plane


def _geocentric(lat: FloatArray, lon: FloatArray, height: FloatArray) -> FloatArray:
    """Earth-centred positions (n, 3) [m]."""
    n = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    across = (n + height) * np.cos(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), ((1.0 - _E2) * n + height) * np.sin(lat)], axis=1)
