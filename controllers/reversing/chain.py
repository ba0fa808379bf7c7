"""Kinematic model of a combination without tyre slip, for reversing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vehicle.combination.description import Vehicle
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray, Pose2


@dataclass(frozen=True, slots=True, kw_only=True)
class RollingChain:
    """Lengths of a tractor and its towed units, each on one axle without steering."""

    wheelbase: float  # of the tractor [m]
    max_steer: float  # of its front wheels [rad]
    hitches: tuple[float, ...]  # of every unit but the last: from its axle forward to its rear hitch [m]
    lengths: tuple[float, ...]  # of every towed unit: hitch to axle [m]

    @classmethod
    def of(cls, vehicle: Vehicle) -> RollingChain:
        """The lengths of a vehicle.

        Raises:
            ValueError: if it tows nothing, or its tractor has no steering.
        """
        tractor, *towed = vehicle.units
        if not towed or tractor.steering is None:
            raise ValueError(f"vehicle {vehicle.name}: must be a tractor with steering that tows a trailer")
        axles = [0.0, *(_rolling_axle(unit) for unit in towed)]  # T has its origin at the rear axle
        return cls(
            wheelbase=tractor.steered_axles[0].x,
            max_steer=tractor.steering.limit,
            hitches=tuple(unit.rear_hitch[0] - x for unit, x in zip(vehicle.units[:-1], axles, strict=False)),
            lengths=tuple(-x for x in axles[1:]),
        )

    def last_axle(self, X_WT: Pose2, articulation: Sequence[float]) -> Pose2:
        """Pose of the last unit's axle for the articulation (N,) at each hitch [rad]."""
        x, y, psi = X_WT
        for hitch, length, gamma in zip(self.hitches, self.lengths, articulation, strict=True):
            ahead, psi = psi, psi - gamma
            x += hitch * math.cos(ahead) - length * math.cos(psi)
            y += hitch * math.sin(ahead) - length * math.sin(psi)
        return Pose2(x, y, psi)

    def rates(self, articulation: FloatArray, curvature: float) -> tuple[FloatArray, FloatArray]:
        """Speeds (N + 1,) and yaw rates (N + 1,) of all axles per metre of the tractor's on a ``curvature`` [1/m]."""
        speeds, yaw_rates = np.ones(1 + len(self.lengths)), np.full(1 + len(self.lengths), curvature)
        for k, (hitch, length) in enumerate(zip(self.hitches, self.lengths, strict=True), start=1):
            c, s = math.cos(articulation[k - 1]), math.sin(articulation[k - 1])
            v_x, v_y = speeds[k - 1], hitch * yaw_rates[k - 1]
            speeds[k], yaw_rates[k] = c * v_x - s * v_y, (s * v_x + c * v_y) / length
        return speeds, yaw_rates

    def steady(self, curvature: float) -> tuple[FloatArray, float]:
        """Articulation (N,) [rad] and the tractor's curvature [1/m] for a curvature of the last axle's path [1/m].

        On a path of curvature k a hitch at the distance d from its axle travels at the angle atan(d k) to the unit. The
        distance from a hitch to the turning centre is the same for both of its units.
        """
        articulation: list[float] = []
        for hitch, length in zip(reversed(self.hitches), reversed(self.lengths), strict=True):
            ahead = curvature / math.sqrt(1.0 + curvature**2 * (length**2 - hitch**2))
            articulation.insert(0, math.atan(length * curvature) - math.atan(hitch * ahead))
            curvature = ahead
        return np.array(articulation), curvature


def _rolling_axle(unit: Unit) -> float:
    """Position of the single axle that is equivalent to a unit's axle group [m].

    The hitch transmits any side force but no moment: sum x F = 0 with forces in proportion to slip, hence
    r = -u sum x / sum x^2.
    """
    positions = [axle.x for axle in unit.axles]
    return sum(x * x for x in positions) / sum(positions)
