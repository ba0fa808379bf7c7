"""What a lens does to the light besides bending it: vignetting, dirt and drops of rain on it, and glare of the sun."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from sensors.camera.lens_map import Floats, LensMap, resampled
from sensors.messages import GreyImage
from sensors.world.textures import fractal_noise
from vehicle.frames import FloatArray

_DIRT: Final = 0.85  # share of the light that a thick crust takes [-]
_SCATTER: Final = 0.3  # share of what it takes that is scattered over the image behind it [-]
_DROP_RADII: Final = (0.012, 0.045)  # of rain drops as they appear, over the image's height and width's mean [-]
_COARSE: Final = 4  # veils are smooth: they are worked out on every fourth pixel
# Veiling glare by the angle from the sun: a halo around it and a wide haze from dust in the optics, as shares of white.
_HALO, _HALO_WIDTH = 1.0, math.radians(7.0)
_HAZE, _HAZE_WIDTH = 0.35, math.radians(28.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drops:
    """Rain drops: each is a small lens that shows the scene upside down and out of focus."""

    cover: Floats  # (h, w) share of each pixel's light that comes through a drop
    at: Floats  # (h, w, 2) where in the image it comes from [px], on the coarse image

    def on(self, light: Floats) -> Floats:
        """The light (h, w) or (h, w, 3) as it is seen through the drops."""
        coarse = cv2.resize(light, None, fx=1.0 / _COARSE, fy=1.0 / _COARSE, interpolation=cv2.INTER_AREA)
        blurred = np.asarray(cv2.GaussianBlur(coarse, (0, 0), 2.0), dtype=np.float32)
        seen: Floats = np.asarray(resampled(blurred, self.at, cv2.INTER_LINEAR), dtype=np.float32)
        cover = self.cover if light.ndim == 2 else self.cover[..., None]
        return np.asarray(light + cover * (seen - light), dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensSurface:
    """One lens: how much light gets through where, and what is on it."""

    passed: Floats | None  # (h, w) share of the light that reaches the sensor; None: all of it
    scattered: Floats | None  # (h, w) share of the mean light that dirt spreads there; None: none
    drops: Drops | None
    directions: Floats | None  # (h/4, w/4, 3) unit vectors that coarse pixels see, if there can be glare

    def through(self, light: Floats) -> Floats:
        """What reaches the sensor of the light (h, w) or (h, w, 3) that the lens gathers."""
        if self.drops is not None:
            light = self.drops.on(light)
        if self.passed is None:
            return light
        passed, scattered = self.passed, self.scattered
        if light.ndim == 3:
            passed, scattered = passed[..., None], None if scattered is None else scattered[..., None]
        dimmed = light * passed
        return dimmed if scattered is None else dimmed + scattered * np.float32(light.mean())

    def glare(self, sun: FloatArray, strength: float) -> Floats:
        """Light (h, w) [grey levels] that a sun in the direction ``sun`` (3,) of the camera's frame spreads."""
        if self.directions is None:
            raise ValueError("this lens was made without glare")
        angle = np.arccos(np.clip(self.directions @ sun.astype(np.float32), -1.0, 1.0))
        return veil_of_light(angle, strength)


def lens_surface(
    rng: np.random.Generator, lens: LensMap, *, vignetting: float, dirt: float, rain: float, glare: bool
) -> LensSurface:
    """The surface of one lens.

    Args:
        rng: decides where dirt and drops are.
        lens: what the camera's pixels see.
        vignetting: share of the light that is lost in the corners, 0 to 1; it grows with the squared distance.
        dirt: share of the image that a crust of dirt covers, 0 to 1.
        rain: share of it that drops cover, 0 to 1.
        glare: whether sun may fall onto the lens.
    """
    dirt_rng, rain_rng = rng.spawn(2)
    shape = lens.rays.shape[:2]
    passed = np.ones(shape, dtype=np.float32)
    if vignetting > 0.0:
        r2 = (lens.rays**2).sum(axis=-1)
        passed -= np.float32(vignetting) * r2 / r2.max()
    crust = crusted(dirt_rng, (shape[0], shape[1]), dirt)
    passed *= 1.0 - _DIRT * crust
    directions = np.concatenate([lens.rays, np.ones((*shape, 1), dtype=np.float32)], axis=-1)[::_COARSE, ::_COARSE]
    return LensSurface(
        passed=passed if vignetting > 0.0 or dirt > 0.0 else None,
        scattered=_SCATTER * _DIRT * crust if dirt > 0.0 else None,
        drops=_drops(rain_rng, (shape[0], shape[1]), rain) if rain > 0.0 else None,
        directions=directions / np.linalg.norm(directions, axis=-1, keepdims=True) if glare else None,
    )


def veil_of_light(angle: Floats, strength: float) -> Floats:
    """What a sun spreads over an image [grey levels] by the angle from it [rad]."""
    veil = _HALO * np.exp(-((angle / _HALO_WIDTH) ** 2)) + _HAZE * np.exp(-angle / _HAZE_WIDTH)
    return np.asarray(255.0 * strength * veil, dtype=np.float32)


def crusted(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Floats:
    """Thickness 0..1 of a crust of dirt that covers a share of an image: blotches with soft edges."""
    if share == 0.0:
        return np.zeros(shape, dtype=np.float32)
    blotches = fractal_noise(rng, shape, 1.5, (2.0 / max(shape), 0.03))
    edge = np.quantile(blotches, 1.0 - share)
    return np.asarray(np.clip((blotches - edge) / 0.35 + 0.5, 0.0, 1.0), dtype=np.float32)


def dirtied(image: GreyImage, crust: Floats) -> GreyImage:
    """A grey image as it is behind a crust."""
    seen = image * (1.0 - _DIRT * crust) + _SCATTER * _DIRT * crust * image.mean()
    return np.asarray(np.rint(seen), dtype=np.uint8)


def _drops(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Drops:
    """Drops wherever they fall until they cover the share."""
    h, w = shape
    size = math.sqrt(h * w)
    cover = np.zeros(shape, dtype=np.float32)
    at = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).astype(np.float32)
    straight = at.copy()
    while cover.mean() < share:
        radius = size * float(np.exp(rng.uniform(*np.log(_DROP_RADII))))
        u, v = rng.uniform(0.0, w), rng.uniform(0.0, h)
        rows = slice(max(int(v - 1.3 * radius), 0), int(v + 1.3 * radius) + 1)
        columns = slice(max(int(u - radius), 0), int(u + radius) + 1)
        p = straight[rows, columns] - np.array([u, v], dtype=np.float32)
        r = np.hypot(p[..., 0], p[..., 1] / 1.25) / radius  # drops hang down a little
        alpha = np.clip((1.0 - r) / 0.3, 0.0, 1.0)
        upside_down = np.array([u, v], dtype=np.float32) - 3.0 * p  # a drop shows some three times its own breadth
        inside = alpha[..., None] > 0.0
        at[rows, columns] = np.where(inside, upside_down, at[rows, columns])
        cover[rows, columns] = np.maximum(cover[rows, columns], 0.92 * alpha)
    return Drops(cover=cover, at=((at + 0.5) / _COARSE - 0.5).astype(np.float32))
