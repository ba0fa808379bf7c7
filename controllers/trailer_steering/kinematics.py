"""How a trailer's axles and its motion belong together: a rigid body led at the hitch, on tyres of equal stiffness.

The lateral velocity of a rigid trailer is linear along its axis and the longitudinal one constant. So the tangent of
the direction of travel beta(x) at the distance x behind the hitch is linear in x:

    tan beta(x) = tan gamma_h (1 - x/Lf) + tan beta_f x/Lf

with the direction gamma_h of the hitch and beta_f of the follow point, Lf behind it. An axle steered by that angle
rolls without slip; all of them then share one instantaneous centre.

Where the axles slip, the moment of their side forces about the hitch, ``sum(x_i C (tan beta_i - tan delta_i))`` for
small slip, balances what the trailer's inertia and the ground's slope ask for. Divided by ``C sum(x_i)`` it is the
*mean slip*: a property of the load, not of the steering, so it can be measured at one moment and used at the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.trailer import Linkage, TrailerGeometry
from vehicle.frames import FloatArray

_NEWTON_STEPS = 5  # from the solution for small angles: 1e-12 rad at any angle that axles are turned by
_STEEPEST = 1.3  # directions of travel are held within this, 74 deg: the tangent stays finite [rad]


@dataclass(frozen=True, slots=True, eq=False)
class AxleGroup:
    """All axles of a trailer, in the terms of its moment balance about the hitch."""

    steered: FloatArray  # (n_steered,) hitch to steered axles [m]
    fixed: FloatArray  # (n_fixed,) hitch to the others [m]
    centre: float  # mean distance of all axles [m]
    first_moment: float  # sum of all distances [m]
    second_moment: float  # sum of their squares [m2]
    follow_distance: float  # [m]
    max_steer: float  # of the actuators [rad]
    linkages: tuple[Linkage, ...]  # steered axles that an actuator turns together

    @classmethod
    def of(cls, trailer: TrailerGeometry) -> AxleGroup:
        """The axle group on the trailer's data sheet."""
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
        """Moment-weighted mean of tan(direction) - tan(steer angle) [-] in the hitch's motion v_x, v_y [m/s]."""
        travel = self.first_moment * v_y / v_x - self.second_moment * yaw_rate / v_x
        return (travel - float(self.steered @ np.tan(angles))) / self.first_moment

    def yaw_per_metre(self, hitch_direction: float, steer_moment: float, mean_slip: float) -> float:
        """Yaw [rad] per metre of the hitch's way, with ``steer_moment = sum(x_i tan(delta_i))`` [m].

        Solves the moment balance for the yaw rate: the inverse of `mean_slip`.
        """
        lead = self.first_moment * (math.tan(held(hitch_direction)) - mean_slip)
        return math.cos(hitch_direction) * (lead - steer_moment) / self.second_moment

    def steer_moment(self, angles: FloatArray) -> FloatArray:
        """``sum(x_i tan(delta_i))`` [m] of angles (..., n_steered) [rad]."""
        moment: FloatArray = np.tan(angles) @ self.steered
        return moment

    def steer_angles(self, hitch_direction: float, follow_direction: float, mean_slip: float) -> FloatArray:
        """Angles (n_steered,) [rad] that send the follow point along ``follow_direction`` [rad], within the limit.

        The steered axles share equally what slip is asked for and what the fixed axles' scrub costs; what one
        of them cannot give at its limit the others take over. Linked axles turn as their actuator lets them.
        """
        lead, follow = math.tan(held(hitch_direction)), math.tan(held(follow_direction))
        slope = (follow - lead) / self.follow_distance
        scrub = float(self.fixed @ (lead + slope * self.fixed))
        tangents = lead + slope * self.steered
        missing = scrub - self.first_moment * mean_slip  # of the steer moment [m]
        return self.linked(np.arctan(self._shared(tangents, missing)))

    def slip_angles(self, mean_slip: float) -> FloatArray:
        """Angles (n_steered,) [rad], equal for all, that let a trailer roll as if its axles did not slip."""
        missing = -self.first_moment * mean_slip
        return self.linked(np.arctan(self._shared(np.zeros(len(self.steered)), missing)))

    def linked(self, angles: FloatArray) -> FloatArray:
        """Angles (n_steered,) [rad] as the linkages let them be, each with the steer moment it was asked for."""
        if not self.linkages:
            return angles
        turned = angles.copy()
        for linkage in self.linkages:
            axles, ratios = list(linkage.axles), np.array(linkage.ratios)
            turned[axles] = ratios * self._actuator_angle(self.steered[axles], ratios, angles[axles])
        return turned

    def _actuator_angle(self, distances: FloatArray, ratios: FloatArray, angles: FloatArray) -> float:
        """The actuator's angle [rad], within its limit, at which its axles have the moment that the angles ask for."""
        moment = float(distances @ np.tan(angles))
        angle = moment / float(distances @ ratios)
        for _ in range(_NEWTON_STEPS):
            tangents = np.tan(ratios * held(angle))
            slope = float((distances * ratios) @ (1.0 + tangents**2))
            angle = held(angle) - (float(distances @ tangents) - moment) / slope
        return max(-self.max_steer, min(self.max_steer, angle))

    def _shared(self, tangents: FloatArray, missing: float) -> FloatArray:
        """Tangents with the missing moment [m] added in equal parts to those not at the limit."""
        limit = math.tan(self.max_steer)
        free = np.ones(len(tangents), dtype=bool)
        for _ in tangents:
            tangents = np.where(free, tangents + missing / float(self.steered[free].sum()), tangents)
            held_back = np.clip(tangents, -limit, limit)
            missing = float(self.steered @ (tangents - held_back))
            tangents, free = held_back, free & (np.abs(tangents) < limit)
            if missing == 0.0 or not free.any():
                break
        return tangents


def held(direction: float) -> float:
    """The direction [rad] held within the range where its tangent is useful."""
    return max(-_STEEPEST, min(_STEEPEST, direction))
