"""Effects of a lens surface on the light: vignetting, dirt, rain drops, and glare of the sun."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from sensors.camera.lens_map import Floats, LensMap, resampled
from sensors.messages import GreyImage
from sensors.textures import fractal_noise
from vehicle.frames import FloatArray

_DIRT: Final = 0.85  # share of the light that thick dirt absorbs or scatters [-]
_SCATTER: Final = 0.3  # share of that light which is scattered over the image behind it [-]
_DROP_RADII: Final = (
    0.012,
    0.045,
)  # apparent radius of rain drops over the mean side of the image [-]
_COARSE: Final = 4  # glare is smooth: it is computed on every fourth pixel
# Veiling glare by the angle from the sun: a halo around it and a wide haze from dust in the optics, as shares of white.
_HALO, _HALO_WIDTH = 1.0, math.radians(7.0)
_HAZE, _HAZE_WIDTH = 0.35, math.radians(28.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drops:
    """Rain drops on a lens: each is a small lens that shows the scene upside down and out of focus."""

    cover: Floats  # (h, w) share of each pixel's light that comes through a drop
    source: Floats  # (h, w, 2) pixel of the coarse image that it comes from [px]

    def apply(self, light: Floats) -> Floats:
        """Light (h, w) or (h, w, 3) behind the drops."""
        coarse = cv2.resize(light, None, fx=1.0 / _COARSE, fy=1.0 / _COARSE, interpolation=cv2.INTER_AREA)
        blurred = np.asarray(cv2.GaussianBlur(coarse, (0, 0), 2.0), dtype=np.float32)
        through: Floats = np.asarray(resampled(blurred, self.source, cv2.INTER_LINEAR), dtype=np.float32)
        cover = self.cover if light.ndim == 2 else self.cover[..., None]
        return np.asarray(light + cover * (through - light), dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensSurface:
    """Transmission of one lens, pixel by pixel, and the dirt and drops on it."""

    transmission: Floats | None  # (h, w) share of the light that reaches the sensor; None: all of it
    scattered: Floats | None  # (h, w) share of the mean light that dirt scatters there; None: none
    drops: Drops | None
    directions: Floats | None  # (h/4, w/4, 3) unit vectors of coarse pixels' rays; None: no glare

    def transmitted(self, light: Floats) -> Floats:
        """Light (h, w) or (h, w, 3) that reaches the sensor."""
        if self.drops is not None:
            light = self.drops.apply(light)
        if self.transmission is None:
            return light
        transmission, scattered = self.transmission, self.scattered
        if light.ndim == 3:
            transmission, scattered = transmission[..., None], None if scattered is None else scattered[..., None]
        dimmed = light * transmission
        return dimmed if scattered is None else dimmed + scattered * np.float32(light.mean())

    def glare(self, sun: FloatArray, strength: float) -> Floats:
        """Glare (h/4, w/4) [grey levels] of a sun in the direction ``sun`` (3,) of the camera's frame."""
        if self.directions is None:
            raise ValueError("this lens surface was constructed without glare")
        angle = np.arccos(np.clip(self.directions @ sun.astype(np.float32), -1.0, 1.0))
        return glare_veil(angle, strength)


def lens_surface(
    rng: np.random.Generator, lens: LensMap, *, vignetting: float, dirt: float, rain: float, glare: bool
) -> LensSurface:
    """Surface of one lens.

    Args:
        rng: of the places of dirt and drops.
        lens: rays of the camera's pixels.
        vignetting: share of the light lost in the corners, 0 to 1; it grows with the squared distance.
        dirt: share of the image that is covered by dirt, 0 to 1.
        rain: share of the image that is covered by drops, 0 to 1.
        glare: True if the sun can shine on the lens.
    """
    dirt_rng, rain_rng = rng.spawn(2)
    shape = lens.rays.shape[:2]
    transmission = np.ones(shape, dtype=np.float32)
    if vignetting > 0.0:
        r2 = (lens.rays**2).sum(axis=-1)
        transmission -= np.float32(vignetting) * r2 / r2.max()
    dirt_map = dirt_layer(dirt_rng, (shape[0], shape[1]), dirt)
    transmission *= 1.0 - _DIRT * dirt_map
    directions = np.concatenate([lens.rays, np.ones((*shape, 1), dtype=np.float32)], axis=-1)[::_COARSE, ::_COARSE]
    return LensSurface(
        transmission=transmission if vignetting > 0.0 or dirt > 0.0 else None,
        scattered=_SCATTER * _DIRT * dirt_map if dirt > 0.0 else None,
        drops=_drops(rain_rng, (shape[0], shape[1]), rain) if rain > 0.0 else None,
        directions=directions / np.linalg.norm(directions, axis=-1, keepdims=True) if glare else None,
    )


def glare_veil(angle: Floats, strength: float) -> Floats:
    """Glare [grey levels] at an angle from the sun [rad]."""
    veil = _HALO * np.exp(-((angle / _HALO_WIDTH) ** 2)) + _HAZE * np.exp(-angle / _HAZE_WIDTH)
    return np.asarray(255.0 * strength * veil, dtype=np.float32)


def dirt_layer(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Floats:
    """Thickness (h, w), 0 to 1, of dirt that covers a share of an image: blotches with soft edges."""
    if share == 0.0:
        return np.zeros(shape, dtype=np.float32)
    blotches = fractal_noise(rng, shape, 1.5, (2.0 / max(shape), 0.03))
    edge = np.quantile(blotches, 1.0 - share)
    return np.asarray(np.clip((blotches - edge) / 0.35 + 0.5, 0.0, 1.0), dtype=np.float32)


def behind_dirt(image: GreyImage, dirt: Floats) -> GreyImage:
    """Grey image behind a layer of dirt."""
    dimmed = image * (1.0 - _DIRT * dirt) + _SCATTER * _DIRT * dirt * image.mean()
    return np.asarray(np.rint(dimmed), dtype=np.uint8)


def _drops(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Drops:
    """Drops at random places until they cover the share of the image."""
    h, w = shape
    size = math.sqrt(h * w)
    cover = np.zeros(shape, dtype=np.float32)
    source = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(np.float32)
    straight = source.copy()
    while cover.mean() < share:
        radius = size * float(np.exp(rng.uniform(*np.log(_DROP_RADII))))
        u, v = rng.uniform(0.0, w), rng.uniform(0.0, h)
        rows = slice(max(int(v - 1.3 * radius), 0), int(v + 1.3 * radius) + 1)
        columns = slice(max(int(u - radius), 0), int(u + radius) + 1)
        p = straight[rows, columns] - np.array([u, v], dtype=np.float32)
        r = np.hypot(p[..., 0], p[..., 1] / 1.25) / radius  # drops sag a little
        alpha = np.clip((1.0 - r) / 0.3, 0.0, 1.0)
        upside_down = np.array([u, v], dtype=np.float32) - 3.0 * p  # a drop shows about three times its own width
        inside = alpha[..., None] > 0.0
        source[rows, columns] = np.where(inside, upside_down, source[rows, columns])
        cover[rows, columns] = np.maximum(cover[rows, columns], 0.92 * alpha)
    return Drops(cover=cover, source=((source + 0.5) / _COARSE - 0.5).astype(np.float32))
