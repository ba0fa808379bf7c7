"""Brush tyre: elastic bristles under a parabolic pressure, which slide from the rear of the contact patch on.

Friction scales the peak and leaves the stiffness.
"""

from __future__ import annotations

from typing import Literal

import casadi as ca

from vehicle.tyres.bristle import Grip, Num, Planar, magnitude, slip_speed
from vehicle.tyres.tyre import StiffnessTyre


class BrushTyre(StiffnessTyre):
    """Elastic bristles under a parabolic pressure."""

    model: Literal["brush"]

    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """With t the sliding share of the patch, 1 - (1 - t)^3 of friction times load is used.

        The moment is the trail times the linear force, reduced by the same share.
        """
        factor = self.load_factor(F_z)
        by_limit = factor * (1.0 / friction)
        pull = by_limit * magnitude(sliding)
        slip = pull / slip_speed(speed, pull, self.relaxation_length)
        t = ca.fmin((self.relaxation_length / 3.0) * slip, 1.0)
        used = t * (3.0 - t * (3.0 - t))
        return Grip(pull / used, friction, factor, 1.0, by_limit, self.trail(F_z, (1.0 - used) * (3.0 * t / used)))
