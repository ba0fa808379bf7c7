"""The plane that a rover stands on, as CasADi expressions."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from vehicle.rover.layout import RoverInput
from vehicle.tyres import Num


class ExcessSlope(NamedTuple):
    """Slope of the ground under a wheel beyond that of the plane, along the plane's axes [-]."""

    along: Num
    across: Num


class Plane(NamedTuple):
    """Plane under a rover; its x axis points forward."""

    e_x: tuple[Num, Num, Num]  # forward, in W
    e_y: tuple[Num, Num, Num]  # to the left, in W
    upright: Num  # z of the normal
    excess: tuple[ExcessSlope, ...]  # by wheel


def plane_under(psi: Num, u: RoverInput[ca.SX]) -> Plane:
    """Plane with the mean slope of the ground under the wheels of a rover with heading psi [rad]."""
    c, s = ca.cos(psi), ca.sin(psi)
    n_wheels = u.slope_x.numel()
    g_x, g_y = ca.sum1(u.slope_x) / n_wheels, ca.sum1(u.slope_y) / n_wheels
    rise = g_x * c + g_y * s
    length = ca.sqrt(1.0 + rise**2)
    upright = 1.0 / ca.sqrt(1.0 + g_x**2 + g_y**2)
    e_x = (c / length, s / length, rise / length)
    n = (-g_x * upright, -g_y * upright, upright)
    e_y = (n[1] * e_x[2] - n[2] * e_x[1], n[2] * e_x[0] - n[0] * e_x[2], n[0] * e_x[1] - n[1] * e_x[0])
    excess = [(u.slope_x[k] - g_x, u.slope_y[k] - g_y) for k in range(n_wheels)]
    along_axes = tuple(ExcessSlope(x * e_x[0] + y * e_x[1], x * e_y[0] + y * e_y[1]) for x, y in excess)
    return Plane(e_x, e_y, upright, along_axes)
