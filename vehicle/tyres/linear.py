"""Linear tyre: force in proportion to slip up to the friction circle."""

from __future__ import annotations

from typing import Literal

import casadi as ca

from vehicle.tyres.bristle import Grip, Num, Planar, magnitude
from vehicle.tyres.tyre import StiffnessTyre


class LinearTyre(StiffnessTyre):
    """Force in proportion to slip up to the friction circle."""

    model: Literal["linear"]

    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """Friction ends the force; beyond it the trail falls with the share of the linear force that is left."""
        factor = self.load_factor(F_z)
        by_limit = factor * (1.0 / friction)
        rolling = (1.0 / self.relaxation_length) * speed
        decay = ca.fmax(rolling, by_limit * magnitude(sliding))
        return Grip(decay, friction, factor, 1.0, by_limit, self.trail(F_z, rolling / decay))
