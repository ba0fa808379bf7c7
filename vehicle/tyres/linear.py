"""Linear tyre: force in proportion to slip up to the friction circle. For numbers or ``casadi.SX``."""

from __future__ import annotations

import casadi as ca

from vehicle.tyres.bristle import Grip, Num, Planar, load_factor, size, trail_at
from vehicle.tyres.data import LinearTyre


def linear_grip(tyre: LinearTyre, F_z: Num, friction: Num, pushed: Planar, speed: Num) -> Grip:
    """Grip of a linear tyre; friction is where its force ends, and the trail beyond it falls with the share left."""
    factor = load_factor(tyre, F_z)
    by_limit = factor * (1.0 / friction)
    rolling = (1.0 / tyre.relaxation_length) * speed
    fading = ca.fmax(rolling, by_limit * size(pushed))
    return Grip(fading, friction, factor, 1.0, by_limit, trail_at(tyre, F_z, rolling / fading))
