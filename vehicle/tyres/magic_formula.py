"""Magic formula: sine of an arc tangent of the slip.

Friction scales the peak and leaves the stiffness: with the linear force over friction as argument there is one curve.
"""

from __future__ import annotations

from typing import Annotated, Literal

import casadi as ca

from vehicle.quantities import quantity
from vehicle.tyres.bristle import Grip, Num, Planar, magnitude, slip_speed
from vehicle.tyres.tyre import StiffnessTyre


class MagicFormulaTyre(StiffnessTyre):
    """Sine of an arc tangent, with the peak at friction times load."""

    model: Literal["magic_formula"]
    shape: Annotated[
        float, quantity("-", ge=1.0, le=2.0, why="1 never falls off; beyond 2 the force would turn round")
    ]  # C; at 1 the force never falls off
    curvature: Annotated[float, quantity("-", ge=-10.0, le=1.0, why="beyond 1 the curve has no single peak")]  # E

    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """Pacejka's formula without offsets, with the peak at friction times load."""
        factor = self.load_factor(F_z)
        by_limit = factor * (1.0 / friction)
        pull = by_limit * magnitude(sliding)
        slip = pull / slip_speed(speed, pull, self.relaxation_length)
        x = (self.relaxation_length / self.shape) * slip
        used = ca.sin(self.shape * ca.atan((1.0 - self.curvature) * x + self.curvature * ca.atan(x)))
        return Grip(pull / used, friction, factor, 1.0, by_limit, self.trail(F_z, 1.0 - used))
