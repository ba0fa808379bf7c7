"""The ground under a vehicle, looked up: what of it the equations of motion and the bodies' poses take.

What is the same everywhere is looked up once. Every look takes ``Places`` as a vector (..., n), so that one vehicle and
many are looked up alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from vehicle.clock import TICK
from vehicle.combination.attitude import Ground, ground_sizes
from vehicle.combination.description import Vehicle
from vehicle.combination.kinematics import Places, place_sizes
from vehicle.combination.plant_inputs import Footing, footing_sizes, spans
from vehicle.frames import FloatArray
from vehicle.surface import Surface

_LOOK_EVERY: Final = 0.1  # way between two looks at changing ground [m]: half of what a tyre smooths over
_MOVING_OFF: Final = 1.0  # speed that whoever stands may reach before the next look [m/s]


def ticks_to_next_look(speed: float) -> int:
    """How long ground that changes from place to place may be taken as it is, at a speed [m/s]."""
    return max(1, int(_LOOK_EVERY / (max(_MOVING_OFF, speed) * TICK)))


class SurfaceUnder:
    """A surface as vehicles of one topology meet it."""

    def __init__(self, surface: Surface, vehicle: Vehicle) -> None:
        self._surface = surface
        self._is_plane = surface.centre is None
        self._is_uniform, self._is_smooth = surface.is_uniform, surface.is_smooth
        self._at = Places(*spans(place_sizes(vehicle)))
        self._footing = Footing(*spans(footing_sizes(vehicle)))
        self._ground = Ground(*spans(ground_sizes(vehicle)))
        slope_x, slope_y = surface.gradient(0.0, 0.0)
        self._usual = np.zeros(self._footing.road.stop)  # what of the footing does not change with place
        self._usual[self._footing.friction] = surface.friction_at(0.0, 0.0)
        self._usual[self._footing.slope_x] = slope_x
        self._usual[self._footing.slope_y] = slope_y
        self._usual_ground = np.zeros(self._ground.slope_y.stop)
        self._usual_ground[self._ground.slope_x] = slope_x
        self._usual_ground[self._ground.slope_y] = slope_y

    @property
    def everywhere(self) -> FloatArray | None:
        """The footing where it is the same everywhere: on one plane of one friction, smooth."""
        return self._usual if self._is_plane and self._is_uniform and self._is_smooth else None

    def footing(self, places: FloatArray) -> FloatArray:
        """``Footing`` of vehicles at these places, (..., n)."""
        surface, at, into = self._surface, self._at, self._footing
        found = _copies(self._usual, places)
        if not self._is_plane:
            slope = surface.gradient(places[..., at.centre_x], places[..., at.centre_y])
            found[..., into.slope_x], found[..., into.slope_y] = slope[..., 0], slope[..., 1]
        if not self._is_uniform:
            found[..., into.friction] = surface.friction_at(places[..., at.wheel_x], places[..., at.wheel_y])
        if not self._is_smooth:
            found[..., into.road] = surface.roughness_at(places[..., at.wheel_x], places[..., at.wheel_y])
        return found

    def ground(self, places: FloatArray) -> FloatArray:
        """``attitude.Ground`` of vehicles at these places, (..., n)."""
        x, y = places[..., self._at.support_x], places[..., self._at.support_y]
        found = _copies(self._usual_ground, places)
        found[..., self._ground.height] = self._surface.height(x, y)
        if not self._is_plane:
            slope = self._surface.gradient(x, y)
            found[..., self._ground.slope_x], found[..., self._ground.slope_y] = slope[..., 0], slope[..., 1]
        return found


class SurfacesUnder:
    """The surfaces under n vehicles: one for all or one for each, looked at one after another.

    Raises:
        ValueError: if there are several surfaces, and not one for each vehicle.
    """

    def __init__(self, surfaces: Surface | Sequence[Surface], vehicle: Vehicle, n: int) -> None:
        self._n = n
        if isinstance(surfaces, Surface):
            self._groups: list[tuple[SurfaceUnder, Any]] = [(SurfaceUnder(surfaces, vehicle), slice(None))]
            return
        if len(surfaces) != n:
            raise ValueError(f"{len(surfaces)} surfaces for {n} vehicles: there must be one for all or one for each")
        lanes: dict[int, list[int]] = {}
        for lane, surface in enumerate(surfaces):
            lanes.setdefault(id(surface), []).append(lane)
        self._groups = [(SurfaceUnder(surfaces[of_one[0]], vehicle), np.array(of_one)) for of_one in lanes.values()]

    @property
    def everywhere(self) -> FloatArray | None:
        """The footing of every vehicle (n, ...) where it is the same everywhere."""
        found = [(under.everywhere, lanes) for under, lanes in self._groups]
        return None if any(same is None for same, _ in found) else self._together(found)

    def footing(self, places: FloatArray) -> FloatArray:
        """``Footing`` of every vehicle, (n, ...)."""
        return self._together([(under.footing(places[lanes]), lanes) for under, lanes in self._groups])

    def _together(self, found: Sequence[tuple[Any, Any]]) -> FloatArray:
        together = np.empty((self._n, found[0][0].shape[-1]))
        for footing, lanes in found:
            together[lanes] = footing
        return together


def _copies(usual: FloatArray, places: FloatArray) -> FloatArray:
    copies = np.empty((*places.shape[:-1], len(usual)))
    copies[...] = usual
    return copies
