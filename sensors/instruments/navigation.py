"""The driver's perception, and an exact reference unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.messages import BodyPose, EgoState
from vehicle.combination.path_point import plan_pose
from vehicle.combination.truth import Truth
from vehicle.frames import rotation_zyx, transform


@dataclass(frozen=True, slots=True)
class DriverPerception:
    """Perception of the tractor's driver; exact, as human perception is not modelled."""

    def sample(self, truth: Truth) -> EgoState:
        """Pose and velocity of the tractor, and the articulation angles."""
        x, y, psi = truth.poses[0].tolist()
        v_x, v_y, yaw_rate = truth.velocities[0].tolist()
        articulation = tuple((-np.diff(truth.poses[:, 2])).tolist())
        return EgoState(
            tick=truth.tick, x=x, y=y, psi=psi, v_x=v_x, v_y=v_y, yaw_rate=yaw_rate, articulation=articulation
        )


@dataclass(frozen=True, slots=True)
class ExactPose:
    """Exact reference of one unit's motion on the road."""

    unit: int
    path_height: float  # of the points that off-tracking is about, in the unit's body [m]

    def sample(self, truth: Truth) -> BodyPose:
        """Pose of the unit in plan: x, y and heading of its hitch at the path's height, as truth is judged by."""
        x, y, psi = plan_pose(truth.bodies[self.unit], self.path_height).tolist()
        return BodyPose(tick=truth.tick, X_WB=transform(rotation_zyx(psi, 0.0, 0.0), np.array([x, y, 0.0])))
