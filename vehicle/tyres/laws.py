"""The law of a tyre by its data, and the steady force that every law stands for; for numbers or ``casadi.SX``."""

from __future__ import annotations

from vehicle.tyres.bristle import Grip, Num, Planar, nominal_stiffness, push
from vehicle.tyres.brush import brush_grip
from vehicle.tyres.data import BrushTyre, LinearTyre, MagicFormulaTyre, Tyre
from vehicle.tyres.linear import linear_grip
from vehicle.tyres.magic_formula import magic_formula_grip
from vehicle.tyres.tmeasy import tmeasy_grip


def grip(tyre: Tyre, F_z: Num, friction: Num, pushed: Planar, speed: Num) -> Grip:
    """What a tyre's law makes of a push [1/s] at a rolling speed [m/s]."""
    if isinstance(tyre, LinearTyre):
        return linear_grip(tyre, F_z, friction, pushed, speed)
    if isinstance(tyre, BrushTyre):
        return brush_grip(tyre, F_z, friction, pushed, speed)
    if isinstance(tyre, MagicFormulaTyre):
        return magic_formula_grip(tyre, F_z, friction, pushed, speed)
    return tmeasy_grip(tyre, F_z, friction, pushed, speed)


def stiffness(F_z: Num, tyre: Tyre) -> Planar:
    """Slip stiffness over load along and across the wheel [-]."""
    C, hold = nominal_stiffness(tyre), grip(tyre, F_z, 1.0, Planar(0.0, 0.0), 1.0)
    return Planar(hold.factor * C.x, hold.factor * hold.skew * C.y)


def steady_force(s: Planar, F_z: Num, friction: Num, tyre: Tyre) -> Planar:
    """Force [N] at a steady slip [-], where the deflection no longer changes."""
    pushed = push(tyre, s.x, -s.y)
    hold = grip(tyre, F_z, friction, pushed, 1.0)
    scale = F_z * hold.factor / hold.fading
    return Planar(scale * pushed.x, scale * hold.skew * pushed.y)
