"""Field of sand with a rover on it."""

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
from sensors.sand.solids import Rock, scattered
from sensors.sand.trace import TraceTruth, WheelHistory
from sensors.sand.tracks import foreign_tracks
from sensors.sand.wheels import Wheel, stands
from sensors.world.sky import Sunlight, daylight
from vehicle.frames import FloatArray
from vehicle.rover.description import Rover
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

LUGS: Final = 20  # on a wheel of El Dorado II; assumed, no photograph is good enough to count them
LUG_HEIGHT: Final = 0.005  # [m], assumed


@dataclass(frozen=True, slots=True, kw_only=True)
class Sun:
    """Position of the sun."""

    azimuth: float  # in W, + left of x [rad]
    elevation: float  # above the horizon [rad]


class SandWorld:
    """Sand under one sun that keeps the imprints of wheels.

    Args:
        kind: one of ``sensors.sand.kinds.KINDS``.
        rng: decides everything not given here; equal generators give bitwise equal worlds.
        rover: leaves traces with its wheels.
        terrain: large shape of the ground.
        route: approximate path (n, 2) of the rover in W [m]: rocks stay clear of it, tracks of others cross it, ripples
            lie across its start.
        sun: None lets ``rng`` draw one from the range of the kind.

    Raises:
        ValueError: for an unknown kind, or a sun too low.
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
        look = kind_named(kind)
        sun_rng, relief_rng, rock_rng, track_rng = rng.spawn(4)
        step = route[min(len(route) - 1, 3)] - route[0]
        ahead = math.atan2(step[1], step[0])
        position = _sun(sun_rng, look, ahead) if sun is None else sun
        self._kind, self._rover, self._terrain, self._sun = look, rover, terrain, position
        self._light = daylight(position.azimuth, elevation=position.elevation, overcast=overcast)
        self._rocks = scattered(rock_rng, look.rocks, route, terrain) if look.rocks else ()
        crest = ahead + relief_rng.uniform(-0.3, 0.3)
        tracks = foreign_tracks(track_rng, route, 0.5 * rover.tread) if look.foreign_tracks else ()
        relief = Relief.draw(relief_rng, look, terrain, crest)
        self._field = Field(
            relief=relief, sun=self._light, tracks=tracks, rocks=self._rocks, reach=Reach.of(self._light)
        )
        tread = Tread(radius=rover.radius, width=rover.width, lugs=LUGS, lug_height=LUG_HEIGHT)
        self._wheels = [Wheel(tread) for _ in rover.wheels]
        self._watched = rover.rear_left
        self._history = WheelHistory()

    @property
    def kind(self) -> SandKind:
        """Kind of sand."""
        return self._kind

    @property
    def rover(self) -> Rover:
        """Rover that leaves traces."""
        return self._rover

    @property
    def terrain(self) -> Terrain:
        """Large shape of the ground."""
        return self._terrain

    @property
    def sun(self) -> Sun:
        """Position of the sun."""
        return self._sun

    @property
    def light(self) -> Sunlight:
        """Light of sun and sky."""
        return self._light

    @property
    def rocks(self) -> tuple[Rock, ...]:
        """Rocks beside the route."""
        return self._rocks

    def drive(self, truths: Sequence[RoverTruth]) -> None:
        """Imprint the wheels' paths through these moments, which continue the earlier ones."""
        moments = [stands(truth) for truth in truths]
        for now, then in zip_longest(moments, moments[1:]):
            for k, wheel in enumerate(self._wheels):
                wheel.roll_on(self._field, now[k], then[k] if then else None)
            self._history = self._history.extended(now[self._watched], now[self._watched].sinkage > 0.0)

    def trace_truth(self, truth: RoverTruth) -> TraceTruth:
        """Trace of the left rear wheel relative to the rover's present pose."""
        x, y = self._rover.wheel_places[self._watched].tolist()
        return self._history.seen_from(truth, (x, y), float(truth.slip_angles[self._watched]))

    def height(self, window: Window) -> Floats:
        """Height of the ground in W [m]."""
        return self._field.height(window)

    def lit(self, window: Window) -> Bytes:
        """Light of sun and sky that a window reflects (2, h, w), see ``sensors.sand.light.encoded``."""
        return self._field.light(window)

    def tint(self, window: Window) -> Bytes:
        """Greyness of the ground: 0 sand, 255 stone."""
        return self._field.tint(window)


def _sun(rng: np.random.Generator, kind: SandKind, ahead: float) -> Sun:
    """Draw a sun from the range of a kind, for a rover that starts towards ``ahead`` [rad]."""
    return Sun(azimuth=ahead + rng.uniform(*kind.azimuth), elevation=rng.uniform(*kind.elevation))
