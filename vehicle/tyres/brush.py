"""Brush tyre: elastic bristles under a parabolic pressure, which slide from the rear of the contact patch on.

Friction scales the peak and leaves the stiffness. For numbers or ``casadi.SX``.
"""

from __future__ import annotations

import casadi as ca

from vehicle.tyres.bristle import Grip, Num, Planar, load_factor, size, trail_at
from vehicle.tyres.data import BrushTyre


def brush_grip(tyre: BrushTyre, F_z: Num, friction: Num, pushed: Planar, speed: Num) -> Grip:
    """Grip of a brush tyre: with t the sliding share of the patch, 1 - (1 - t)^3 of friction times load is used.

    Its moment is the trail times the linear force, less by the same share.
    """
    factor = load_factor(tyre, F_z)
    by_limit = factor * (1.0 / friction)
    pull = by_limit * size(pushed)
    t = ca.fmin((tyre.relaxation_length / 3.0) * (pull / speed), 1.0)
    used = t * (3.0 - t * (3.0 - t))
    return Grip(pull / used, friction, factor, 1.0, by_limit, trail_at(tyre, F_z, (1.0 - used) * (3.0 * t / used)))
