"""Light on sand: how much of the sun and of the sky each texel sends back, baked where the ground has changed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from sensors.sand.grid import TEXEL, Bytes, Floats, Window
from sensors.sand.relief import ALBEDO
from sensors.world.sunlight import Sunlight

_HIGHEST: Final = 0.034  # of what throws shadows on the ground by itself, above the ground around it [m]
_PENUMBRA: Final = np.float32(0.0006)  # height over which a shadow fades: edges of sand are blunt [m]
_NARROW, _BROAD = 17, 61  # texels a side of the surroundings that hide a part of the sky
_PACKED: Final = 0.10  # share of its light that sand pressed by a wheel loses: smoother, and damp from below; assumed
_COVERED: Final = 0.8  # share of what lies on the sand, such as pebbles, that a wheel presses below it; assumed


@dataclass(frozen=True, slots=True)
class Reach:
    """How far around a texel its light depends on the ground, and where its own shadow falls."""

    rays: tuple[tuple[int, int, float], ...]  # rows, columns towards the sun, and how high the ray is there [m]
    before: Window  # texels around a texel that its light comes over, its own being the first
    behind: Window  # texels around it whose light it may change

    @classmethod
    def of(cls, light: Sunlight) -> Reach:
        """Of the sun where it stands."""
        across = math.hypot(light.direction[0], light.direction[1])
        near = _NARROW // 2 + 1
        if light.overcast or across < 1e-3:  # no shadows, or the sun at the zenith
            return cls((), Window(*[_BROAD // 2 + 1] * 4), Window(*[near] * 4))
        slope = float(light.direction[2]) / across
        length, rays, k = _HIGHEST / slope / TEXEL, [], 1.0
        while k < length:
            row, column = (round(k * float(light.direction[axis]) / across) for axis in (1, 0))
            rays.append((row, column, math.hypot(row, column) * TEXEL * slope))
            k = 1.15 * k + 0.7
        row, column = (_outward(length * float(light.direction[axis]) / across) for axis in (1, 0))
        low = _BROAD // 2 + 1
        return cls(
            tuple(rays),
            Window(max(low, -row), max(low, -column), max(low, row), max(low, column)),
            Window(max(near, row), max(near, column), max(near, -row), max(near, -column)),
        )


def _outward(length: float) -> int:
    """The next whole number away from 0."""
    return math.ceil(length) if length > 0.0 else math.floor(length)


def around(window: Window, by: Window) -> Window:
    """A window and so many texels more on its sides."""
    return Window(window.top - by.top, window.left - by.left, window.bottom + by.bottom, window.right + by.right)


def sunlit(height: Floats, reach: Reach, light: Sunlight) -> tuple[Floats, Floats]:
    """Share of the sun's and of the sky's light that falls on the part of a height map that ``reach`` leaves."""
    top, left = reach.before.top, reach.before.left
    h, w = height.shape[0] - top - reach.before.bottom, height.shape[1] - left - reach.before.right

    def beside(row: int, column: int) -> Floats:
        return height[top + row : top + row + h, left + column : left + column + w]

    here = beside(0, 0)
    slope_x = (beside(0, 1) - beside(0, -1)) * np.float32(0.5 / TEXEL)
    slope_y = (beside(1, 0) - beside(-1, 0)) * np.float32(0.5 / TEXEL)
    upright = np.float32(1.0) / cv2.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    sx, sy, sz = (np.float32(part) for part in light.direction)
    facing = np.maximum((sz - sx * slope_x - sy * slope_y) * upright, 0.0)
    if reach.rays:
        over = np.full(here.shape, -np.inf, dtype=np.float32)  # highest ray of the sun that is stopped
        ray = np.empty(here.shape, dtype=np.float32)
        for row, column, rise in reach.rays:
            np.subtract(beside(row, column), np.float32(rise), out=ray)
            np.maximum(over, ray, out=over)
        hidden = np.clip((over - here) / _PENUMBRA + np.float32(0.5), 0.0, 1.0)
        facing *= 1.0 - hidden
    middle = (slice(top, top + h), slice(left, left + w))
    hollow = np.maximum(cv2.blur(height, (_NARROW, _NARROW))[middle] - here, 0.0) * np.float32(60.0)
    hollow += np.maximum(cv2.blur(height, (_BROAD, _BROAD))[middle] - here, 0.0) * np.float32(22.0)
    open_sky = np.clip(1.0 - hollow, 0.35, 1.0) * (0.75 + 0.25 * upright)
    return np.asarray(facing, dtype=np.float32), np.asarray(open_sky, dtype=np.float32)


def sent_back(albedo: Bytes, packed: Bytes, sun: Floats, sky: Floats) -> Bytes:
    """Light of sun and sky that comes back (2, h, w), as the root of its share: bytes are then as fine as eyes are."""
    own = albedo.astype(np.float32)
    pressed = packed.astype(np.float32) * np.float32(1.0 / 255.0)
    own += (np.float32(ALBEDO * (1.0 - _PACKED)) - own) * (np.float32(_COVERED) * pressed)
    share = own * np.float32(0.5 / ALBEDO)
    sent = np.empty((2, *share.shape), np.uint8)
    for plane, light in zip(sent, (sun, sky), strict=True):
        plane[...] = np.minimum(255.0 * cv2.sqrt(share * light), 255.0)
    return sent


def came_back(sent: Bytes | Floats) -> Floats:
    """The share (h, w) of the sun's or of the sky's light from what ``sent_back`` says of it."""
    share: Floats = np.square(sent, dtype=np.float32)
    share *= np.float32(2.0 / 255.0**2)
    return share
