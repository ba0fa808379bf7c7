"""Tyre forces through the deflection of an elastic carcass, for any law of the steady force.

Each direction of each wheel has a deflection state n: the force over load that it would cause at the nominal load.
Sliding builds it up and it decays, n' = C_0 V_s / sigma - decay n; the force is n times the load and a factor for that
load. A law gives the decay rate: with decay = speed / sigma * (linear force / steady force) the steady state is the law
at every speed, and n stays bounded by about the friction also at standstill, where slip is not defined. Both directions
have one decay rate, so a sliding wheel pulls along its stiffness-weighted slip.

The side force acts behind the wheel's centre by the pneumatic trail, which vanishes as the contact patch slides. Not
modelled: camber, turn slip.

Every function takes numbers or ``casadi.SX``.
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import casadi as ca

Num: TypeAlias = "float | ca.SX"

ROLLING_SPEED_FLOOR: Final = 0.05  # keeps slip finite at rest; below it brakes hold with creep of its size * slip [m/s]
_TINY: Final = 1e-12  # square of a rate [1/s2]: avoids 0 / 0


class Planar(NamedTuple):
    """A quantity of a wheel along (x, forward) and across (y, left) its plane."""

    x: Num
    y: Num


class Grip(NamedTuple):
    """Tyre-law output: decay rate of the deflection, and the scale and limit of the force."""

    decay: Num  # rate at which a deflection decays [1/s]
    limit: Num  # largest force over load in any direction [-]
    factor: Num  # stiffness over the nominal one, along the wheel [-]
    skew: Num  # the same across, over that along [-]
    factor_by_limit: Num  # factor / limit [-]
    trail: Num  # distance behind the wheel's centre at which the side force acts when rolling forward [m]


class Contact(NamedTuple):
    """Tyre force and its sensitivities."""

    force: Planar  # [N]
    per_deflection: Num  # along the wheel [N]
    use_along: Num  # squared share of the largest force that acts along the wheel [-]


def rolling_speed(v_x: Num) -> Num:
    """Magnitude of v_x [m/s], at least the floor."""
    return ca.fmax(ca.fabs(v_x), ROLLING_SPEED_FLOOR)


def magnitude(rate: Planar) -> Num:
    """Magnitude of a deflection rate [1/s], never quite zero."""
    return ca.sqrt(rate.x**2 + (rate.y**2 + _TINY))


def deflection_rate(n: Planar, sliding: Planar, decay: Num) -> Planar:
    """Rate of the deflection [1/s]; ``sliding`` is the part that sliding builds up, from ``Tyre.sliding_rate``."""
    return Planar(sliding.x - decay * n.x, sliding.y - decay * n.y)


def contact(n: Planar, n_rate: Planar, F_z: Num, grip: Grip, damping: Num) -> Contact:
    """Force of a deflected and deflecting tyre, bounded by its limit."""
    x = n.x + damping * n_rate.x
    y = grip.skew * (n.y + damping * n_rate.y)
    squares = grip.factor_by_limit**2
    demand = ca.fmax((x**2 + y**2) * squares, 1.0)  # squared, over the limit; at least 1
    scale = (F_z * grip.factor) / ca.sqrt(demand)
    return Contact(Planar(scale * x, scale * y), scale, x**2 * squares / demand)
