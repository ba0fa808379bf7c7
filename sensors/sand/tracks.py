"""Older tracks of other vehicles."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from sensors.sand.grid import Window, slumped
from sensors.sand.imprint import Roll, Sand, Tread, imprinted, strip_of, window_of
from sensors.sand.relief import Relief
from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_OFFSET: Final = (0.17, 0.33)  # of a track along the route from the rover's own left wheels [m]
_SWEEPS: Final = 4  # of slumping after an imprint
_SPACING: Final = 0.95  # of tracks across the route [m]


class Track(NamedTuple):
    """Straight track of one wheel."""

    roll: Roll
    tread: Tread


def pressed_by(track: Track, window: Window, sand: Sand, relief: Relief) -> Sand:
    """Sand of a window after a track was pressed into it."""
    roll, tread = track
    reach = roll.reach(tread)
    part = window.common(window_of(roll, reach))
    if part.is_empty:
        return sand
    strip = strip_of(roll, part, reach)
    if not strip.inside.any():
        return sand
    at = part.within(window)
    before = Sand(sand.height[at], sand.packed[at])
    crumbs, large = relief.crumbs(part).texels(strip.inside), relief.large(part)[strip.inside]
    after, _ = imprinted(roll, tread, strip, before.texels(strip.inside), large, crumbs, roll.sinkage * tread.width)
    new = before.with_texels(strip.inside, after)
    height, packed = sand.height.copy(), sand.packed.copy()
    height[at], packed[at] = slumped(new.height, strip.inside, _SWEEPS), new.packed
    return Sand(height, packed)


def foreign_tracks(rng: np.random.Generator, route: FloatArray, wheel_left: float) -> tuple[Track, ...]:
    """Draw tracks beside and across the left wheels' path, for a rover whose middle takes a route (n, 2)."""
    along = arc_length(route)
    tracks = []
    for centre in np.arange(0.7, along[-1], _SPACING):
        s = centre + rng.uniform(-0.25, 0.25)
        turn = rng.choice((-1.0, 1.0)) * math.radians(rng.uniform(25.0, 90.0))
        tracks.append(_track(rng, _place(route, along, s, wheel_left), turn, half=1.2))
    for start in np.arange(0.2, along[-1], 3.2):
        side = rng.choice((-1.0, 1.0)) * rng.uniform(*_OFFSET)
        turn = math.radians(rng.uniform(-4.0, 4.0))
        tracks.append(_track(rng, _place(route, along, start + 1.5, wheel_left + side), turn, half=1.5))
    return tuple(tracks)


def _place(route: FloatArray, along: FloatArray, s: float, left: float) -> tuple[FloatArray, float]:
    """Point at a distance ``s`` along a route and ``left`` of it [m], and the route's direction there [rad]."""
    place = np.array([np.interp(s, along, route[:, k]) for k in (0, 1)])
    k = int(np.clip(np.searchsorted(along, s) - 1, 0, len(route) - 2))
    step = route[k + 1] - route[k]
    direction = math.atan2(step[1], step[0])
    return place + left * np.array([-math.sin(direction), math.cos(direction)]), direction


def _track(rng: np.random.Generator, at: tuple[FloatArray, float], turn: float, half: float) -> Track:
    """Draw a track through a place, at an angle ``turn`` [rad] to a direction, ``half`` [m] to both sides."""
    middle, direction = at
    towards = np.array([math.cos(direction + turn), math.sin(direction + turn)])
    tread = Tread(
        radius=rng.uniform(0.09, 0.14),
        width=rng.uniform(0.08, 0.13),
        lugs=int(rng.integers(16, 28)),
        lug_height=rng.uniform(0.003, 0.005),
    )
    length = 2.0 * half
    roll = Roll(
        a=middle - half * towards,
        b=middle + half * towards,
        towards_a=towards,
        towards_b=towards,
        slip_angle=0.0,
        turned_a=0.0,
        turned_b=length / tread.radius / (1.0 - rng.uniform(0.0, 0.15)),
        sinkage=rng.uniform(0.006, 0.010),
    )
    return Track(roll, tread)
