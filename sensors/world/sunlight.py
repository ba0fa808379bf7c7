"""Where the sun stands and what light it and the sky give."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from vehicle.frames import FloatArray

Colour = tuple[float, float, float]  # relative light in red, green, blue

_ELEVATION: Final = 0.75  # of the sun if nothing else is said [rad]
_LOWEST: Final = math.radians(3.0)  # lower suns throw shadows of twenty heights, and hills would hide them [rad]
_SUN: Final = np.array([0.92, 0.87, 0.76])  # at the usual elevation
_SKY: Final = np.array([0.40, 0.45, 0.52])
_OVERCAST: Final = np.array([0.66, 0.69, 0.73])
# Optical depth of clear air towards the zenith: Rayleigh's 0.04, 0.09, 0.19 at 680, 550, 450 nm and some dust.
_DEPTH: Final = np.array([0.07, 0.12, 0.22])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sunlight:
    """The light of a day."""

    direction: FloatArray  # (3,) unit vector towards the sun in W
    sun_colour: Colour  # of what falls straight onto a surface; nothing behind clouds
    sky_colour: Colour  # of what falls onto level ground from all around
    sky_tint: Colour  # multiplies the colours of sky and haze: towards evening they take the sun's
    overcast: bool
    seen: bool  # whether the sun itself is drawn where it stands


def daylight(
    chance: float, *, azimuth: float | None = None, elevation: float | None = None, overcast: bool = False
) -> Sunlight:
    """The light of a sun at a place in the sky.

    Args:
        chance: direction of the sun in the plane, from W's x to the left, if no azimuth is given [rad].
        azimuth: from north by east, as on a compass: 3/2 pi is west [rad].
        elevation: above the horizon [rad].
        overcast: clouds hide the sun, and there are no shadows.

    Raises:
        ValueError: for a sun too low or beyond the zenith.
    """
    height = _ELEVATION if elevation is None else elevation
    if not _LOWEST <= height <= 0.5 * math.pi:
        raise ValueError(f"sun elevation = {math.degrees(height):g} deg must be between 3 and 90")
    plane = chance if azimuth is None else 0.5 * math.pi - azimuth
    lost = np.exp(-_DEPTH * (_air_mass(height) - _air_mass(_ELEVATION)))
    clear = 0.5 + 0.5 * min(1.0, math.sin(height) / math.sin(_ELEVATION))  # a low sun lights half as bright a sky
    sun = _SUN * lost
    tint = (0.6 + 0.4 * clear) * (clear + (1.0 - clear) * sun / sun.max())
    return Sunlight(
        direction=np.array([np.cos(plane), np.sin(plane), np.tan(height)]) * np.cos(height),
        sun_colour=(0.0, 0.0, 0.0) if overcast else _colour(sun),
        sky_colour=_colour(clear * (_OVERCAST if overcast else _SKY)),
        sky_tint=_colour(tint),
        overcast=overcast,
        seen=not overcast and (azimuth is not None or elevation is not None),
    )


def _air_mass(elevation: float) -> float:
    """How much air the light has come through, in zenith heights (Rozenberg's formula)."""
    s = math.sin(elevation)
    return 1.0 / (s + 0.025 * math.exp(-11.0 * s))


def _colour(rgb: FloatArray) -> Colour:
    return float(rgb[0]), float(rgb[1]), float(rgb[2])
