"""Brush tyre: elastic bristles under a parabolic pressure, which slide from the rear of the contact patch on.

Friction scales the peak and leaves the stiffness.
"""

from __future__ import annotations

from typing import Literal

import casadi as ca

from vehicle.tyres.bristle import Grip, Num, Planar, magnitude
from vehicle.tyres.tyre import StiffnessTyre


class BrushTyre(StiffnessTyre):
    """Elastic bristles under a parabolic pressure."""

    model: Literal["brush"]

    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """With t the sliding share of the patch, 1 - (1 - t)^3 of friction times load is used.

        The moment is the trail times the linear force, reduced by the same share: 1 - used times 3 t over used.
        """
        # With the slip over ``slip_speed``, t is the smaller of sigma / 3 * slip and 1: the pull over the larger of
        # 3 / sigma * speed and the pull itself, at every speed and at rest.
        factor = self.load_factor(F_z)
        by_limit = factor * (1.0 / friction)
        pull = by_limit * magnitude(sliding)
        most = ca.fmax((3.0 / self.relaxation_length) * speed, pull)
        t = pull / most
        per_share = 1.0 / (3.0 - t * (3.0 - t))  # t over the share of the limit that is used
        return Grip(most * per_share, friction, factor, 1.0, by_limit, self.trail(F_z, 3.0 * (per_share - t)))
