"""A field of sand with a rover on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Final

import numpy as np

from sensors.sand.field import Field
from sensors.sand.grid import Bytes, Floats, Window
from sensors.sand.imprint import Tread
from sensors.sand.kinds import SandKind, kind_named
from sensors.sand.light import Reach
from sensors.sand.relief import Relief
from sensors.sand.rocks import Rock, scattered
from sensors.sand.trace import Passed, TraceTruth
from sensors.sand.tracks import foreign_tracks
from sensors.sand.wheels import Wheel, stands
from sensors.world.sunlight import Sunlight, daylight
from vehicle.frames import FloatArray
from vehicle.rover.description import Rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

LUGS: Final = 20  # around El Dorado's wheels; counted on no photograph good enough: assumed
LUG_HEIGHT: Final = 0.005  # [m], assumed


@dataclass(frozen=True, slots=True, kw_only=True)
class Sun:
    """Where the sun stands."""

    azimuth: float  # in W, + left of x [rad]
    elevation: float  # above the horizon [rad]


class SandWorld:
    """Sand that keeps what wheels do to it, under one sun.

    Args:
        kind: one of ``sensors.sand.kinds.KINDS``.
        rng: decides everything that is not said; worlds of equal generators are equal to the last bit.
        rover: whose wheels leave traces.
        terrain: large shape of the ground.
        route: way (n, 2) in W that the rover is going to take, roughly: rocks keep off it, tracks of others cross it,
            ripples lie across its beginning [m].
        sun: None lets ``rng`` take one that suits the kind.

    Raises:
        ValueError: for a kind that is not known, or a sun too low.
    """

    def __init__(
        self,
        kind: str,
        *,
        rng: np.random.Generator,
        rover: Rover,
        terrain: Terrain,
        route: FloatArray,
        sun: Sun | None = None,
        overcast: bool = False,
    ) -> None:
        what = kind_named(kind)
        sun_rng, relief_rng, rock_rng, track_rng = rng.spawn(4)
        step = route[min(len(route) - 1, 3)] - route[0]
        ahead = math.atan2(step[1], step[0])
        where = _sun(sun_rng, what, ahead) if sun is None else sun
        self._kind, self._rover, self._terrain, self._sun = what, rover, terrain, where
        self._light = daylight(where.azimuth, elevation=where.elevation, overcast=overcast)
        self._rocks = scattered(rock_rng, what.rocks, route, terrain) if what.rocks else ()
        crest = ahead + relief_rng.uniform(-0.3, 0.3)
        tracks = foreign_tracks(track_rng, route, 0.5 * rover.tread) if what.foreign_tracks else ()
        relief = Relief.draw(relief_rng, what, terrain, crest)
        self._field = Field(
            relief=relief, sun=self._light, tracks=tracks, rocks=self._rocks, reach=Reach.of(self._light)
        )
        tread = Tread(radius=rover.radius, width=rover.width, lugs=LUGS, lug_height=LUG_HEIGHT)
        self._wheels = [Wheel(tread) for _ in rover.wheels]
        self._watched = rover.rear_left
        self._passed = Passed()

    @property
    def kind(self) -> SandKind:
        """What the ground is made of."""
        return self._kind

    @property
    def rover(self) -> Rover:
        """Whose wheels leave traces."""
        return self._rover

    @property
    def terrain(self) -> Terrain:
        """Large shape of the ground."""
        return self._terrain

    @property
    def sun(self) -> Sun:
        """Where the sun stands."""
        return self._sun

    @property
    def light(self) -> Sunlight:
        """Of sun and sky."""
        return self._light

    @property
    def rocks(self) -> tuple[Rock, ...]:
        """Beside the way."""
        return self._rocks

    def drive(self, truths: Sequence[RoverTruth]) -> None:
        """Let the wheels imprint the way through these moments, each of which goes on from the one before."""
        moments = [stands(truth) for truth in truths]
        for now, then in zip_longest(moments, moments[1:]):
            for k, wheel in enumerate(self._wheels):
                wheel.roll_on(self._field, now[k], then[k] if then else None)
            self._passed = self._passed.on(now[self._watched], now[self._watched].sinkage > 0.0)

    def trace_truth(self, truth: RoverTruth) -> TraceTruth:
        """What there is to be seen of the left rear wheel's trace, seen from where the rover is now."""
        x, y = self._rover.wheel_places[self._watched].tolist()
        return self._passed.seen_from(truth, (x, y), float(truth.slip_angles[self._watched]))

    def height(self, window: Window) -> Floats:
        """Of the ground in W [m]."""
        return self._field.height(window)

    def lit(self, window: Window) -> Bytes:
        """Light of sun and sky that comes back from a window (2, h, w), see ``sensors.sand.light.sent_back``."""
        return self._field.light(window)

    def tint(self, window: Window) -> Bytes:
        """How grey the ground is."""
        return self._field.tint(window)


def _sun(rng: np.random.Generator, kind: SandKind, ahead: float) -> Sun:
    """A sun that suits a kind of ground, for a rover that sets off towards ``ahead`` [rad]."""
    return Sun(azimuth=ahead + rng.uniform(*kind.azimuth), elevation=rng.uniform(*kind.elevation))
