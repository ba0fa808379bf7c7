"""The plane that a rover stands on, as CasADi expressions."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from vehicle.rover.layout import RoverInput
from vehicle.tyres import Num


class Lean(NamedTuple):
    """How much more than the plane the ground under a wheel rises along the plane's axes [-]."""

    along: Num
    across: Num


class Plane(NamedTuple):
    """A plane whose axes head where the rover does."""

    e_x: tuple[Num, Num, Num]  # forward, in W
    e_y: tuple[Num, Num, Num]  # to the left, in W
    upright: Num  # z of the normal
    leans: tuple[Lean, ...]  # by wheel


def plane_under(psi: Num, u: RoverInput[ca.SX]) -> Plane:
    """The plane that leans as the ground does on average under the wheels of a rover that heads to psi [rad]."""
    c, s = ca.cos(psi), ca.sin(psi)
    n_wheels = u.slope_x.numel()
    g_x, g_y = ca.sum1(u.slope_x) / n_wheels, ca.sum1(u.slope_y) / n_wheels
    rise = g_x * c + g_y * s
    length = ca.sqrt(1.0 + rise**2)
    upright = 1.0 / ca.sqrt(1.0 + g_x**2 + g_y**2)
    e_x = (c / length, s / length, rise / length)
    n = (-g_x * upright, -g_y * upright, upright)
    e_y = (n[1] * e_x[2] - n[2] * e_x[1], n[2] * e_x[0] - n[0] * e_x[2], n[0] * e_x[1] - n[1] * e_x[0])
    beyond = [(u.slope_x[k] - g_x, u.slope_y[k] - g_y) for k in range(n_wheels)]
    leans = tuple(Lean(x * e_x[0] + y * e_x[1], x * e_y[0] + y * e_y[1]) for x, y in beyond)
    return Plane(e_x, e_y, upright, leans)
