"""Tyre forces: a magic formula with combined slip, reached through the deflection of an elastic carcass.

Each direction of each wheel has a deflection state z (dimensionless: the slip that would cause it in the linear
range). It follows the sliding of the contact patch and its steady state is the magic formula at every speed; it is
bounded by about friction over stiffness, also at standstill, where a slip is not defined.

Friction scales the peak and leaves the initial stiffness. Not modelled: pneumatic trail and aligning moment, camber,
turn slip; a sliding wheel pulls along its stiffness-weighted slip, not exactly against its sliding velocity.

Every function takes numbers or ``casadi.SX``.
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import casadi as ca

from vehicle.description import Tyre

Num: TypeAlias = "float | ca.SX"

ROLLING_SPEED_FLOOR: Final = 0.05  # keeps slip finite at rest; below it brakes hold with creep of its size * slip [m/s]
_TINY_SLIP: Final = 1e-6  # smooths the length of the slip vector at zero [-]


class Planar(NamedTuple):
    """A quantity of a wheel along (x, forward) and across (y, left) its plane."""

    x: Num
    y: Num


def stiffness(F_z: Num, tyre: Tyre) -> Planar:
    """Slip stiffness over load along and across the wheel [-]; it falls with load."""
    factor = 1.0 - tyre.load_sensitivity * (F_z / tyre.nominal_load - 1.0)
    factor = ca.fmax(factor, 0.2)  # the straight line is fitted between one and two nominal loads
    return Planar(tyre.longitudinal_stiffness * factor, tyre.cornering_stiffness * factor)


def slip(V_s: Planar, v_x: Num) -> Planar:
    """Slip: sliding velocity [m/s] of the tyre against the ground's pull over rolling speed v_x [m/s]."""
    speed = rolling_speed(v_x)
    return Planar(V_s.x / speed, V_s.y / speed)


def rolling_speed(v_x: Num) -> Num:
    """Size of v_x [m/s], never quite zero."""
    return ca.sqrt(v_x * v_x + ROLLING_SPEED_FLOOR**2)


def saturation(s: Planar, friction: Num, C: Planar, tyre: Tyre) -> Num:
    """Share of the linear force that the magic formula leaves at a slip, 1 for small slip."""
    rho = ca.sqrt((C.x * s.x) ** 2 + (C.y * s.y) ** 2 + _TINY_SLIP**2) / friction
    x = rho / tyre.shape
    return ca.sin(tyre.shape * ca.atan(x - tyre.curvature * (x - ca.atan(x)))) / rho


def steady_force(s: Planar, F_z: Num, friction: Num, tyre: Tyre) -> Planar:
    """Force [N] of the magic formula at a steady slip."""
    C = stiffness(F_z, tyre)
    scale = F_z * saturation(s, friction, C, tyre)
    return Planar(C.x * scale * s.x, C.y * scale * s.y)


def deflection_rate(z: Planar, V_s: Planar, v_x: Num, F_z: Num, friction: Num, tyre: Tyre) -> Planar:
    """Rate of the deflection [1/s]; at rest (rate 0) the force is ``steady_force``."""
    fading = rolling_speed(v_x) / saturation(slip(V_s, v_x), friction, stiffness(F_z, tyre), tyre)
    return Planar((V_s.x - fading * z.x) / tyre.relaxation_length, (V_s.y - fading * z.y) / tyre.relaxation_length)


def force(z: Planar, z_rate: Planar, F_z: Num, friction: Num, tyre: Tyre) -> Planar:
    """Force [N] of a deflected and deflecting tyre; never beyond friction times load."""
    C = stiffness(F_z, tyre)
    x = C.x * (z.x + tyre.damping * z_rate.x)
    y = C.y * (z.y + tyre.damping * z_rate.y)
    demand = ca.sqrt(x * x + y * y + _TINY_SLIP**2) / friction
    scale = F_z / ca.fmax(demand, 1.0)
    return Planar(scale * x, scale * y)
