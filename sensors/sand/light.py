"""Light on sand: sun and sky that each texel reflects, updated where the ground has changed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from sensors.sand.grid import TEXEL, Bytes, Floats, Window
from sensors.sand.relief import ALBEDO
from sensors.world.sky import Sunlight

_HIGHEST: Final = 0.034  # largest height of relief above the ground around it [m]
_PENUMBRA: Final = np.float32(0.0006)  # height over which a shadow fades, as edges of sand are blunt [m]
_NARROW, _BROAD = 17, 61  # texels a side of the surroundings that hide parts of the sky
_PACKED: Final = 0.10  # loss of albedo of compacted sand, which is smoother and damp from below; assumed
_COVERED: Final = 0.8  # share of the cover, such as pebbles, that a wheel presses into the sand; assumed


@dataclass(frozen=True, slots=True)
class Reach:
    """Surroundings of a texel on which its light depends, and which its own shadow changes."""

    rays: tuple[tuple[int, int, float], ...]  # rows, columns towards the sun, and height of the ray there [m]
    before: Window  # margins around a texel with the ground that its light depends on
    behind: Window  # margins around it with the texels whose light it may change

    @classmethod
    def of(cls, light: Sunlight) -> Reach:
        """Surroundings for a position of the sun."""
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
    """Next whole number away from 0."""
    return math.ceil(length) if length > 0.0 else math.floor(length)


def around(window: Window, margins: Window) -> Window:
    """Window with margins on its four sides."""
    return Window(
        window.top - margins.top,
        window.left - margins.left,
        window.bottom + margins.bottom,
        window.right + margins.right,
    )


def sunlit(height: Floats, reach: Reach, light: Sunlight) -> tuple[Floats, Floats]:
    """Shares of the light of sun and sky on the inner part of a height map, inside the margins ``reach.before``."""
    top, left = reach.before.top, reach.before.left
    h, w = height.shape[0] - top - reach.before.bottom, height.shape[1] - left - reach.before.right

    def shifted(row: int, column: int) -> Floats:
        return height[top + row : top + row + h, left + column : left + column + w]

    here = shifted(0, 0)
    slope_x = (shifted(0, 1) - shifted(0, -1)) * np.float32(0.5 / TEXEL)
    slope_y = (shifted(1, 0) - shifted(-1, 0)) * np.float32(0.5 / TEXEL)
    upright = np.float32(1.0) / cv2.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    sx, sy, sz = (np.float32(part) for part in light.direction)
    facing = np.maximum((sz - sx * slope_x - sy * slope_y) * upright, 0.0)
    if reach.rays:
        over = np.full(here.shape, -np.inf, dtype=np.float32)  # highest ray of the sun that is blocked
        ray = np.empty(here.shape, dtype=np.float32)
        for row, column, rise in reach.rays:
            np.subtract(shifted(row, column), np.float32(rise), out=ray)
            np.maximum(over, ray, out=over)
        hidden = np.clip((over - here) / _PENUMBRA + np.float32(0.5), 0.0, 1.0)
        facing *= 1.0 - hidden
    middle = (slice(top, top + h), slice(left, left + w))
    hollow = np.maximum(cv2.blur(height, (_NARROW, _NARROW))[middle] - here, 0.0) * np.float32(60.0)
    hollow += np.maximum(cv2.blur(height, (_BROAD, _BROAD))[middle] - here, 0.0) * np.float32(22.0)
    open_sky = np.clip(1.0 - hollow, 0.35, 1.0) * (0.75 + 0.25 * upright)
    return np.asarray(facing, dtype=np.float32), np.asarray(open_sky, dtype=np.float32)


def encoded(albedo: Bytes, packed: Bytes, sun: Floats, sky: Floats) -> Bytes:
    """Reflected shares of sun and sky (2, h, w) as bytes: square roots, which are as fine in the dark as needed."""
    own = albedo.astype(np.float32)
    pressed = packed.astype(np.float32) * np.float32(1.0 / 255.0)
    own += (np.float32(ALBEDO * (1.0 - _PACKED)) - own) * (np.float32(_COVERED) * pressed)
    share = own * np.float32(0.5 / ALBEDO)
    roots = np.empty((2, *share.shape), np.uint8)
    for plane, light in zip(roots, (sun, sky), strict=True):
        plane[...] = np.minimum(255.0 * cv2.sqrt(share * light), 255.0)
    return roots


def decoded(roots: Bytes | Floats) -> Floats:
    """Reflected share (h, w) of sun or sky from the output of ``encoded``."""
    share: Floats = np.square(roots, dtype=np.float32)
    share *= np.float32(2.0 / 255.0**2)
    return share
