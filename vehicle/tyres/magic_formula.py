"""Magic formula: sine of an arc tangent of the slip. For numbers or ``casadi.SX``.

Friction scales the peak and leaves the stiffness: with the linear force over friction as argument there is one curve.
"""

from __future__ import annotations

import casadi as ca

from vehicle.tyres.bristle import Grip, Num, Planar, load_factor, size, trail_at
from vehicle.tyres.data import MagicFormulaTyre


def magic_formula_grip(tyre: MagicFormulaTyre, F_z: Num, friction: Num, pushed: Planar, speed: Num) -> Grip:
    """Grip of the magic formula."""
    factor = load_factor(tyre, F_z)
    by_limit = factor * (1.0 / friction)
    pull = by_limit * size(pushed)
    x = (tyre.relaxation_length / tyre.shape) * (pull / speed)
    used = ca.sin(tyre.shape * ca.atan((1.0 - tyre.curvature) * x + tyre.curvature * ca.atan(x)))
    return Grip(pull / used, friction, factor, 1.0, by_limit, trail_at(tyre, F_z, 1.0 - used))
