"""Ground under a vehicle, looked up on its surface: the ground inputs of the plant, and the smooth ground for poses.

Values that are the same everywhere are looked up once. Lookups take ``Kinematics`` as a vector (..., n), for one
vehicle or many.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from vehicle.clock import TICK
from vehicle.combination.attitude import SmoothGround, smooth_ground_sizes
from vehicle.combination.description import Vehicle
from vehicle.combination.plant_inputs import GroundInputs, ground_input_sizes, slices
from vehicle.combination.truth_vectors import Kinematics, kinematics_sizes
from vehicle.frames import FloatArray
from vehicle.surface import Surface

_LOOKUP_DISTANCE: Final = 0.1  # travelled between two lookups of changing ground [m]: half a contact patch
_LEAST_SPEED: Final = 1.0  # that a vehicle at rest may reach before the next lookup [m/s]


def ticks_to_next_lookup(speed: float) -> int:
    """Number of ticks for which changing ground is held, at a speed [m/s]."""
    return max(1, int(_LOOKUP_DISTANCE / (max(_LEAST_SPEED, speed) * TICK)))


class SurfaceLookup:
    """A surface, sampled at the wheels and units of vehicles of one topology."""

    def __init__(self, surface: Surface, vehicle: Vehicle) -> None:
        self._surface = surface
        self._is_plane = surface.is_plane
        self._is_uniform, self._is_smooth = surface.is_uniform, surface.is_smooth
        self._at = Kinematics(*slices(kinematics_sizes(vehicle)))
        self._inputs = GroundInputs(*slices(ground_input_sizes(vehicle)))
        self._smooth = SmoothGround(*slices(smooth_ground_sizes(vehicle)))
        slope_x, slope_y = surface.gradient(0.0, 0.0)
        self._default_inputs = np.zeros(self._inputs.wind.stop)  # the values that do not change with position
        self._default_inputs[self._inputs.friction] = surface.friction_at(0.0, 0.0)
        self._default_inputs[self._inputs.slope_x] = slope_x
        self._default_inputs[self._inputs.slope_y] = slope_y
        self._default_smooth = np.zeros(self._smooth.slope_y.stop)
        self._default_smooth[self._smooth.slope_x] = slope_x
        self._default_smooth[self._smooth.slope_y] = slope_y

    @property
    def constant(self) -> FloatArray | None:
        """The ``GroundInputs`` of a smooth plane of one friction; None if they change with position."""
        calm = self._surface.gust is None
        return self._default_inputs if calm and self._is_plane and self._is_uniform and self._is_smooth else None

    def ground_inputs(self, kinematics: FloatArray) -> FloatArray:
        """``GroundInputs`` of vehicles at these positions, (..., n)."""
        surface, at, into = self._surface, self._at, self._inputs
        inputs = _copies(self._default_inputs, kinematics)
        if not self._is_plane:
            slope = surface.gradient(kinematics[..., at.centre_x], kinematics[..., at.centre_y])
            inputs[..., into.slope_x], inputs[..., into.slope_y] = slope[..., 0], slope[..., 1]
        if not self._is_uniform:
            inputs[..., into.friction] = surface.friction_at(kinematics[..., at.wheel_x], kinematics[..., at.wheel_y])
        if not self._is_smooth:
            inputs[..., into.road] = surface.roughness_at(kinematics[..., at.wheel_x], kinematics[..., at.wheel_y])
        if surface.gust is not None and into.wind.stop > into.wind.start:
            inputs[..., into.wind] = surface.gust.velocity_at(kinematics[..., at.centre_x])
        return inputs

    def smooth_ground(self, kinematics: FloatArray) -> FloatArray:
        """``SmoothGround`` of vehicles at these positions, (..., n)."""
        x, y = kinematics[..., self._at.support_x], kinematics[..., self._at.support_y]
        ground = _copies(self._default_smooth, kinematics)
        ground[..., self._smooth.height] = self._surface.height(x, y)
        if not self._is_plane:
            slope = self._surface.gradient(x, y)
            ground[..., self._smooth.slope_x], ground[..., self._smooth.slope_y] = slope[..., 0], slope[..., 1]
        return ground


def _copies(row: FloatArray, kinematics: FloatArray) -> FloatArray:
    """An array with a copy of the row for every vehicle."""
    copies = np.empty((*kinematics.shape[:-1], len(row)))
    copies[...] = row
    return copies
