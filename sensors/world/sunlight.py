"""Position of the sun, and the light of sun and sky."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from vehicle.frames import FloatArray

Colour = tuple[float, float, float]  # relative light in red, green, blue

_ELEVATION: Final = 0.75  # default elevation of the sun [rad]
_LOWEST: Final = math.radians(3.0)  # of the sun; shadows are then twenty times the height [rad]
_SUN: Final = np.array([0.92, 0.87, 0.76])  # at the default elevation
_SKY: Final = np.array([0.40, 0.45, 0.52])
_OVERCAST: Final = np.array([0.66, 0.69, 0.73])
# Optical depth of clear air towards the zenith: Rayleigh scattering, 0.04, 0.09, 0.19 at 680, 550, 450 nm, plus dust.
_DEPTH: Final = np.array([0.07, 0.12, 0.22])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sunlight:
    """Light of sun and sky."""

    direction: FloatArray  # (3,) unit vector towards the sun in W
    sun_colour: Colour  # irradiance of a surface that faces the sun; zero behind clouds
    sky_colour: Colour  # irradiance of level ground by the sky
    sky_tint: Colour  # multiplies the colours of sky and haze; close to the sun's colour at a low sun
    overcast: bool
    visible: bool  # True: the sun itself is drawn


def daylight(
    chance: float, *, azimuth: float | None = None, elevation: float | None = None, overcast: bool = False
) -> Sunlight:
    """Light of a sun at a given position in the sky.

    Args:
        chance: azimuth of the sun from W's x axis, + left, if no ``azimuth`` is given [rad].
        azimuth: from north, + east; 3/2 pi is west [rad].
        elevation: above the horizon [rad].
        overcast: True if clouds hide the sun; there are no shadows.

    Raises:
        ValueError: if the elevation is not between 3 deg and 90 deg.
    """
    height = _ELEVATION if elevation is None else elevation
    if not _LOWEST <= height <= 0.5 * math.pi:
        raise ValueError(f"sun elevation = {math.degrees(height):g} deg must be between 3 and 90")
    plane = chance if azimuth is None else 0.5 * math.pi - azimuth
    transmission = np.exp(-_DEPTH * (_air_mass(height) - _air_mass(_ELEVATION)))
    clear = 0.5 + 0.5 * min(1.0, math.sin(height) / math.sin(_ELEVATION))  # under a low sun the sky is half as bright
    sun = _SUN * transmission
    tint = (0.6 + 0.4 * clear) * (clear + (1.0 - clear) * sun / sun.max())
    return Sunlight(
        direction=np.array([np.cos(plane), np.sin(plane), np.tan(height)]) * np.cos(height),
        sun_colour=(0.0, 0.0, 0.0) if overcast else _colour(sun),
        sky_colour=_colour(clear * (_OVERCAST if overcast else _SKY)),
        sky_tint=_colour(tint),
        overcast=overcast,
        visible=not overcast and (azimuth is not None or elevation is not None),
    )


def _air_mass(elevation: float) -> float:
    """Relative air mass along the line of sight (Rozenberg's formula)."""
    s = math.sin(elevation)
    return 1.0 / (s + 0.025 * math.exp(-11.0 * s))


def _colour(rgb: FloatArray) -> Colour:
    return float(rgb[0]), float(rgb[1]), float(rgb[2])
