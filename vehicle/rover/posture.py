"""Posture of a rover on its terrain: pose of the body, places and velocities of the wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from vehicle.frames import FloatArray, Pose2, cross, transform
from vehicle.rover.description import Rover
from vehicle.rover.layout import RoverState
from vehicle.rover.terrain import Terrain

_AT_REST: Final = 1e-6  # below it a velocity is rounding and has no direction [m/s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Posture:
    """Pose of the body, places and velocities of the wheels."""

    X_WB: FloatArray  # (4, 4)
    wheels: FloatArray  # (n, 3) lowest points in W [m]
    wheel_velocities: FloatArray  # (n, 2) along and across each wheel's heading [m/s]


class Undercarriage:
    """Wheels of a rover as they stand on terrain."""

    def __init__(self, rover: Rover) -> None:
        self._places = rover.wheel_places
        # Weighted sums of the wheels' points, in the order of falling weights, point forward and to the left.
        weights = (self._places / self._places.max(axis=0)).T
        self._order = np.argsort(-weights, axis=1, kind="stable")  # (2, n)
        self._weights = np.take_along_axis(weights, self._order, axis=1)[:, :, None]  # (2, n, 1)

    def posture(self, terrain: Terrain, s: RoverState[FloatArray]) -> Posture:
        """Posture in a state: the body is parallel to the least-squares plane of the wheels' lowest points."""
        p, origin = self._places, np.array([s.x[0], s.y[0]])
        flat = Pose2(float(s.x[0]), float(s.y[0]), float(s.psi[0])).apply(p)
        for _ in range(2):  # an inclined body covers less of the map than a level one
            lowest = _lowest(flat, terrain, s)
            R_WB = self._attitude(lowest)
            flat = p @ R_WB[:2, :2].T + origin
        return Posture(
            X_WB=transform(R_WB, lowest.mean(axis=0)),
            wheels=_lowest(flat, terrain, s),
            wheel_velocities=_wheel_velocities(p, s),
        )

    def _attitude(self, lowest: FloatArray) -> FloatArray:
        """R_WB of the body from the wheels' lowest points in W (n, 3)."""
        forward, leftward = (self._weights * lowest[self._order]).sum(axis=1)
        e_x = forward / math.sqrt(forward @ forward)
        up = cross(e_x, leftward)
        e_z = up / math.sqrt(up @ up)
        return np.column_stack([e_x, cross(e_z, e_x), e_z])


def _lowest(flat: FloatArray, terrain: Terrain, s: RoverState[FloatArray]) -> FloatArray:
    """Lowest points (n, 3) of wheels above these points (n, 2) of the map [m]."""
    points = np.empty((len(flat), 3))
    points[:, :2] = flat
    points[:, 2] = terrain.height(flat[:, 0], flat[:, 1]) - s.sinkage
    return points


def slip_ratios(rim: FloatArray, v_x: FloatArray) -> FloatArray:
    """Slip ratios [-]: (r omega - v_x) / r omega of driving wheels, / v_x of braking ones; 0 at rest.

    Above 1 a driving wheel moves against its rotation.
    """
    over = np.where(rim * (rim - v_x) > 0.0, rim, v_x)
    return np.divide(rim - v_x, over, out=np.zeros_like(rim), where=np.abs(over) > _AT_REST)


def slip_angles(velocities: FloatArray) -> FloatArray:
    """Directions of travel of wheels relative to their headings [rad], from velocities (n, 2); 0 at rest."""
    angles = np.arctan2(velocities[:, 1], velocities[:, 0])
    return np.where(np.hypot(velocities[:, 0], velocities[:, 1]) > _AT_REST, angles, 0.0)


def _wheel_velocities(p: FloatArray, s: RoverState[FloatArray]) -> FloatArray:
    v_x, v_y = s.v_x - s.yaw_rate * p[:, 1], s.v_y + s.yaw_rate * p[:, 0]
    c, d = np.cos(s.steer), np.sin(s.steer)
    return np.column_stack([v_x * c + v_y * d, v_y * c - v_x * d])
