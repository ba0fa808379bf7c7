"""Kinematics of a trailer: a rigid body led at the hitch, on tyres of equal stiffness.

The lateral velocity of a rigid trailer is linear along its axis and the longitudinal one constant. So the tangent of
the direction of travel beta(x) at the distance x behind the hitch is linear in x:

    tan beta(x) = tan gamma_h (1 - x/Lf) + tan beta_f x/Lf

with the direction gamma_h of the hitch and beta_f of the follow point, Lf behind it. An axle steered by that angle
rolls without slip; all of them then share one instantaneous centre.

Where the axles slip, the moment of their side forces about the hitch, ``sum(x_i C (tan beta_i - tan delta_i))`` for
small slip, balances the moments of inertia and of the ground's slope. Divided by ``C sum(x_i)`` it is the *mean slip*:
a property of the load, not of the steering, so that it can be measured at one moment and used at the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.trailer import Linkage, TrailerGeometry
from vehicle.frames import FloatArray, limited_angle

_NEWTON_STEPS = 5  # from the solution for small angles: 1e-12 rad within the range of axles
_STEEPEST = 1.3  # limit of directions of travel, 74 deg: the tangent stays finite [rad]


@dataclass(frozen=True, slots=True, eq=False)
class AxleGroup:
    """Axles of a trailer, for the moment balance about the hitch."""

    steered: FloatArray  # (n_steered,) hitch to steered axles [m]
    fixed: FloatArray  # (n_fixed,) hitch to the others [m]
    centre: float  # mean distance of all axles [m]
    first_moment: float  # sum of all distances [m]
    second_moment: float  # sum of their squares [m2]
    follow_distance: float  # [m]
    max_steer: float  # of the actuators [rad]
    linkages: tuple[Linkage, ...]  # steered axles that share an actuator

    @classmethod
    def of(cls, trailer: TrailerGeometry) -> AxleGroup:
        """The axle group of a trailer's data sheet."""
        every, steered = np.array(trailer.axle_distances), np.array(trailer.steered, dtype=bool)
        return cls(
            steered=every[steered],
            fixed=every[~steered],
            centre=float(every.mean()),
            first_moment=float(every.sum()),
            second_moment=float(every @ every),
            follow_distance=trailer.follow_distance,
            max_steer=trailer.max_steer,
            linkages=trailer.linkages,
        )

    def mean_slip(self, v_x: float, v_y: float, yaw_rate: float, angles: FloatArray) -> float:
        """Moment-weighted mean of tan(direction) - tan(steer angle) [-] for the hitch's velocity v_x, v_y [m/s]."""
        travel = self.first_moment * v_y / v_x - self.second_moment * yaw_rate / v_x
        return (travel - float(self.steered @ np.tan(angles))) / self.first_moment

    def yaw_per_metre(self, hitch_direction: float, steer_moment: float, mean_slip: float) -> float:
        """Yaw [rad] per metre of the hitch's path, for ``steer_moment = sum(x_i tan(delta_i))`` [m].

        Solves the moment balance for the yaw rate: the inverse of `mean_slip`.
        """
        lead = self.first_moment * (math.tan(limited_direction(hitch_direction)) - mean_slip)
        return math.cos(hitch_direction) * (lead - steer_moment) / self.second_moment

    def steer_moment(self, angles: FloatArray) -> FloatArray:
        """``sum(x_i tan(delta_i))`` [m] of angles (..., n_steered) [rad]."""
        moment: FloatArray = np.tan(angles) @ self.steered
        return moment

    def steer_angles(self, hitch_direction: float, follow_direction: float, mean_slip: float) -> FloatArray:
        """Angles (n_steered,) [rad], within the limit, for travel of the follow point along ``follow_direction`` [rad].

        The steered axles share the mean slip and the scrub of the fixed axles equally; the others take over what an
        axle at its limit lacks. Linked axles turn with their actuator.
        """
        lead, follow = math.tan(limited_direction(hitch_direction)), math.tan(limited_direction(follow_direction))
        slope = (follow - lead) / self.follow_distance
        scrub = float(self.fixed @ (lead + slope * self.fixed))
        tangents = lead + slope * self.steered
        missing = scrub - self.first_moment * mean_slip  # of the steer moment [m]
        return self.linked(np.arctan(self._shared(tangents, missing)))

    def slip_angles(self, mean_slip: float) -> FloatArray:
        """Equal angles (n_steered,) [rad] that compensate the mean slip."""
        missing = -self.first_moment * mean_slip
        return self.linked(np.arctan(self._shared(np.zeros(len(self.steered)), missing)))

    def with_moment(self, angles: FloatArray, missing: float, free: NDArray[np.bool_]) -> FloatArray:
        """Angles (n_steered,) [rad] with the ``missing`` steer moment [m] shared equally by the ``free`` axles."""
        if not free.any():
            return angles
        return np.where(free, self.linked(np.arctan(self._shared(np.tan(angles), missing, free))), angles)

    def linked(self, angles: FloatArray) -> FloatArray:
        """Angles (n_steered,) [rad] that the linkages allow, each linkage with the steer moment of the given angles."""
        if not self.linkages:
            return angles
        turned = angles.copy()
        for linkage in self.linkages:
            axles, ratios = list(linkage.axles), np.array(linkage.ratios)
            turned[axles] = ratios * self._actuator_angle(self.steered[axles], ratios, angles[axles])
        return turned

    def _actuator_angle(self, distances: FloatArray, ratios: FloatArray, angles: FloatArray) -> float:
        """Angle of an actuator [rad], within its limit, at which its axles have the moment of the given angles."""
        moment = float(distances @ np.tan(angles))
        angle = moment / float(distances @ ratios)
        for _ in range(_NEWTON_STEPS):
            tangents = np.tan(ratios * limited_direction(angle))
            slope = float((distances * ratios) @ (1.0 + tangents**2))
            angle = limited_direction(angle) - (float(distances @ tangents) - moment) / slope
        return limited_angle(angle, self.max_steer)

    def _shared(self, tangents: FloatArray, missing: float, free: NDArray[np.bool_] | None = None) -> FloatArray:
        """Tangents with the missing moment [m] shared equally by the free axles, by default all, below the limit."""
        limit = math.tan(self.max_steer)
        free = np.ones(len(tangents), dtype=bool) if free is None else free
        for _ in tangents:
            tangents = np.where(free, tangents + missing / float(self.steered[free].sum()), tangents)
            clipped = np.clip(tangents, -limit, limit)
            missing = float(self.steered @ (tangents - clipped))
            tangents, free = clipped, free & (np.abs(tangents) < limit)
            if missing == 0.0 or not free.any():
                break
        return tangents


def limited_direction(direction: float) -> float:
    """The direction [rad], limited to where its tangent is useful."""
    return limited_angle(direction, _STEEPEST)
