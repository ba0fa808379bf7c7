"""Closed forms of rolling without slip: tractrix, steady turns, path-following steer law, roundabout limits.

Radii are those of circles about the turning centre [m]. Angles are positive to the left; turns are to the left.
"""

from __future__ import annotations

import math


def tractrix_articulation(radius: float, length: float, turned: float) -> float:
    """Articulation [rad] of a trailer whose hitch enters a circle along a tangent and has ``turned`` by an angle [rad].

    gamma' = 1 - (R / L) sin(gamma) over the path's angle, from 0. The half-angle tangent gives a Riccati equation with
    constant coefficients. Valid for trailers shorter than the radius, R > L; longer ones jackknife.
    """
    k = radius / length
    b = math.sqrt(k * k - 1.0)
    t = math.tanh(0.5 * b * turned)
    return 2.0 * math.atan(t / (b + k * t))


def follow_point_off_tracking(radius: float, axle: float, follow: float) -> float:
    """Off-tracking [m] of a point ``follow`` behind the hitch, axle at ``axle``, hitch on a steady circle.

    Measured square to the trailer's axis, as by de Saxe, from the follow point to the hitch's circle.
    """
    return math.sqrt(radius**2 - (follow - axle) ** 2) - math.sqrt(radius**2 - axle**2)


def front_axle_off_tracking(radius: float, wheelbase: float, hitch: float, length: float) -> float:
    """Off-tracking [m] of the trailer's axle from the front axle's circle, after WHI and SAE J695.

    ``hitch`` is the kingpin's distance ahead of the tractor's rear axle.
    """
    return radius - math.sqrt(radius**2 - wheelbase**2 + hitch**2 - length**2)


def path_following_steer(radius: float, axle: float, follow: float) -> float:
    """Steer angle [rad] of an axle ``axle`` behind the hitch that keeps the follow point on the hitch's circle.

    Its tangent is (Lf / 2) / sqrt(R^2 - Lf^2 / 4) at the hitch, the opposite at the follow point, linear in between.
    """
    return math.atan(-(axle - 0.5 * follow) / math.sqrt(radius**2 - 0.25 * follow**2))


def longest_wheelbase_on_the_roundabout(
    width: float, *, outer: float = 12.5, inner: float = 5.3, kingpin_to_front: float = 2.04
) -> float:
    """Longest distance from kingpin to axle [m] of a semi-trailer deemed to comply with the roundabout of 97/27/EC."""
    return math.sqrt((outer - kingpin_to_front) ** 2 - (inner + 0.5 * width) ** 2)
