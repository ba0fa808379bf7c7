"""The sun with its light, and the sky as a panorama at infinity, with clouds and a far ridge at the horizon."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from sensors.textures import NoiseArray, TextureArray, coloured, fractal_noise, sigmoid, to_bytes
from vehicle.frames import FloatArray

_Colour = tuple[float, float, float]  # relative light in red, green, blue
_ELEVATION: Final = 0.75  # default elevation of the sun [rad]
_SUN: Final = np.array([0.92, 0.87, 0.76])  # at the default elevation
_SKY: Final = np.array([0.40, 0.45, 0.52])
_OVERCAST_LIGHT: Final = np.array([0.66, 0.69, 0.73])
# Optical depth of clear air towards the zenith: Rayleigh scattering, 0.04, 0.09, 0.19 at 680, 550, 450 nm, plus dust.
_DEPTH: Final = np.array([0.07, 0.12, 0.22])
LOWEST = -0.10  # elevation of the panorama's lower edge [rad]
HIGHEST = 0.80  # elevation of its upper edge; the sky above continues the upper row [rad]
HAZE = (0.74, 0.80, 0.86)  # colour of distant objects
_OVERCAST = 0.85  # brightness of clouds without sun [-]
_SOFT = 0.0018  # width of the transition from hill to sky at a ridge [rad]
_SHAPE = (512, 4096)  # rows, columns [px]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sunlight:
    """Light of sun and sky."""

    direction: FloatArray  # (3,) unit vector towards the sun in W
    sun_colour: _Colour  # irradiance of a surface that faces the sun; zero behind clouds
    sky_colour: _Colour  # irradiance of level ground by the sky
    sky_tint: _Colour  # multiplies the colours of sky and haze; close to the sun's colour at a low sun
    overcast: bool
    visible: bool  # True: the sun itself is drawn


def panorama(rng: np.random.Generator, light: Sunlight) -> TextureArray:
    """Colours (rows, columns, 3); the first row is the highest, columns are uniform in W's azimuth."""
    elevation = np.linspace(HIGHEST, LOWEST, _SHAPE[0], dtype=np.float32)[:, None]
    height = np.clip(elevation / HIGHEST, 0.0, 1.0)
    clear = coloured(np.broadcast_to(np.sqrt(height), _SHAPE), HAZE, (0.30, 0.50, 0.80))
    cover = _clouds(rng) * np.clip(height * 9.0, 0.0, 1.0)
    shaded = coloured(0.5 + 0.16 * fractal_noise(rng, _SHAPE, 1.1, (0.002, 0.1)), (0.72, 0.75, 0.80), (1.0, 1.0, 0.99))
    sky = _OVERCAST * shaded if light.overcast else clear + cover[..., None] * (shaded - clear)
    if light.visible:
        sky = _with_sun(sky, elevation, light)
    return to_bytes(_with_ridges(rng, sky, elevation) * np.array(light.sky_tint, dtype=np.float32))


def _with_sun(sky: NoiseArray, elevation: NoiseArray, light: Sunlight) -> NoiseArray:
    """The sky with the sun: a saturated disc and an aureole in the sun's colour."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, _SHAPE[1], endpoint=False, dtype=np.float32)[None, :]
    sun = light.direction.astype(np.float32)
    level = np.cos(elevation) * (np.cos(azimuth) * sun[0] + np.sin(azimuth) * sun[1])
    angle = np.arccos(np.clip(level + np.sin(elevation) * sun[2], -1.0, 1.0))[..., None]
    colour = np.array(light.sun_colour, dtype=np.float32) / np.float32(max(light.sun_colour))
    aureole = 0.8 * np.exp(-((angle / 0.03) ** 2)) + 0.5 * np.exp(-angle / 0.15)
    return np.asarray(sky + aureole * colour / np.array(light.sky_tint, dtype=np.float32), dtype=np.float32)


def _clouds(rng: np.random.Generator) -> NoiseArray:
    """Cloud cover 0 to 1: cumulus clouds, flattened towards the horizon."""
    heaps = fractal_noise(rng, (_SHAPE[0] * 2, _SHAPE[1]), 1.75, (0.002, 0.2))
    row = np.linspace(1.0, 0.0, _SHAPE[0]) ** 0.6  # clouds look flatter near the horizon
    return sigmoid(3.0 * (heaps[(row * (len(heaps) - 1)).astype(int)] - 0.15))


def _with_ridges(rng: np.random.Generator, sky: NoiseArray, elevation: NoiseArray) -> NoiseArray:
    """The panorama with three ridges of wooded hills, paler with distance."""
    for base, spread, colour in ((0.040, 0.012, 0.75), (0.026, 0.009, 0.50), (0.012, 0.006, 0.25)):
        crest = base + spread * fractal_noise(rng, (1, _SHAPE[1]), 1.3, (0.0008, 0.03))
        crest = crest + 0.0012 * fractal_noise(rng, (1, _SHAPE[1]), 0.3, (0.02, 0.4))  # tree tops
        grain = fractal_noise(rng, _SHAPE, 0.9, (0.01, 0.3))
        low = int(np.argmax(elevation[:, 0] < crest.max() + _SOFT))  # first row of the ridge
        woods = np.array([0.20, 0.28, 0.20], dtype=np.float32) * (1.0 + 0.12 * grain[low:, :, None])
        hill = np.float32(colour) * np.array(HAZE, dtype=np.float32) + np.float32(1.0 - colour) * woods
        inside = np.clip((crest - elevation[low:]) / _SOFT + 0.5, 0.0, 1.0)[..., None]
        sky[low:] += np.asarray(inside * (hill - sky[low:]), dtype=np.float32)
    return sky


def daylight(
    chance: float, *, azimuth: float | None = None, elevation: float | None = None, overcast: bool = False
) -> Sunlight:
    """Light of a sun at a given position in the sky.

    Args:
        chance: azimuth of the sun from W's x axis, + left, if no ``azimuth`` is given [rad].
        azimuth: from north, + east; 3/2 pi is west [rad].
        elevation: above the horizon [rad].
        overcast: True if clouds hide the sun; there are no shadows.
    """
    height = _ELEVATION if elevation is None else elevation
    plane = chance if azimuth is None else 0.5 * math.pi - azimuth
    transmission = np.exp(-_DEPTH * (_air_mass(height) - _air_mass(_ELEVATION)))
    clear = 0.5 + 0.5 * min(1.0, math.sin(height) / math.sin(_ELEVATION))  # under a low sun the sky is half as bright
    sun = _SUN * transmission
    tint = (0.6 + 0.4 * clear) * (clear + (1.0 - clear) * sun / sun.max())
    return Sunlight(
        direction=np.array([np.cos(plane), np.sin(plane), np.tan(height)]) * np.cos(height),
        sun_colour=(0.0, 0.0, 0.0) if overcast else _colour(sun),
        sky_colour=_colour(clear * (_OVERCAST_LIGHT if overcast else _SKY)),
        sky_tint=_colour(tint),
        overcast=overcast,
        visible=not overcast and (azimuth is not None or elevation is not None),
    )


def _air_mass(elevation: float) -> float:
    """Relative air mass along the line of sight (Rozenberg's formula)."""
    s = math.sin(elevation)
    return 1.0 / (s + 0.025 * math.exp(-11.0 * s))


def _colour(rgb: FloatArray) -> _Colour:
    return float(rgb[0]), float(rgb[1]), float(rgb[2])
