"""Sensors of motion: the driver's own perception, and an exact reference unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.messages import BodyPose, EgoState
from vehicle.combination.truth import Truth


@dataclass(frozen=True, slots=True)
class DriverPerception:
    """What the driver of the tractor sees and feels; people are not what offtrack models, so it is exact."""

    def sample(self, truth: Truth) -> EgoState:
        """Where the tractor is and how it moves."""
        x, y, psi = truth.poses[0].tolist()
        v_x, v_y, yaw_rate = truth.velocities[0].tolist()
        towed = tuple((-np.diff(truth.poses[:, 2])).tolist())
        return EgoState(tick=truth.tick, x=x, y=y, psi=psi, v_x=v_x, v_y=v_y, yaw_rate=yaw_rate, articulation=towed)


@dataclass(frozen=True, slots=True)
class ExactPose:
    """A reference unit without any error on one unit's body."""

    unit: int

    def sample(self, truth: Truth) -> BodyPose:
        """Pose of the unit's body."""
        return BodyPose(tick=truth.tick, X_WB=truth.bodies[self.unit].copy())
