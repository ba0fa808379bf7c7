"""Tyre forces through the deflection of an elastic carcass, whatever the law of the steady force.

Each direction of each wheel has a deflection state n: the force over load that it would make at the nominal load.
Sliding pushes it and it fades, n' = C_0 V_s / sigma - fading n; its force is n times the load and a factor for that
load. A law says how fast a deflection fades: at fading = speed / sigma * (linear force / steady force) the steady state
is the law at every speed, and n is bounded by about the friction also at standstill, where a slip is not defined. Both
directions fade alike, so a sliding wheel pulls along its stiffness-weighted slip.

The side force acts behind the wheel's centre by the pneumatic trail, which vanishes as the contact patch slides. Not
modelled: camber, turn slip.

Every function takes numbers or ``casadi.SX``.
"""

from __future__ import annotations

from typing import Final, NamedTuple, TypeAlias

import casadi as ca

from vehicle.tyres.data import BrushTyre, LinearTyre, MagicFormulaTyre, Tyre

Num: TypeAlias = "float | ca.SX"

ROLLING_SPEED_FLOOR: Final = 0.05  # keeps slip finite at rest; below it brakes hold with creep of its size * slip [m/s]
_TINY: Final = 1e-12  # square of a push [1/s2]: keeps 0 / 0 away
_LEAST_STIFFNESS: Final = 0.2  # of the nominal one: the straight line is fitted between one and two nominal loads


class Planar(NamedTuple):
    """A quantity of a wheel along (x, forward) and across (y, left) its plane."""

    x: Num
    y: Num


class Grip(NamedTuple):
    """What a law makes of a push: how the deflection fades, and what its force is."""

    fading: Num  # rate at which a deflection fades [1/s]
    limit: Num  # largest force over load in any direction [-]
    factor: Num  # stiffness over the nominal one, along the wheel [-]
    skew: Num  # the same across over that along [-]
    factor_by_limit: Num  # factor / limit [-]
    trail: Num  # how far behind the wheel's centre the side force acts when rolling forward [m]


class Contact(NamedTuple):
    """The force of a tyre, and what it owes to."""

    force: Planar  # [N]
    per_deflection: Num  # along the wheel [N]
    use_along: Num  # squared share of the largest force that acts along the wheel [-]


def rolling_speed(v_x: Num) -> Num:
    """Size of v_x [m/s], never quite zero."""
    return ca.fmax(ca.fabs(v_x), ROLLING_SPEED_FLOOR)


def nominal_stiffness(tyre: Tyre) -> Planar:
    """Slip stiffness over load along and across the wheel at the nominal load [-]."""
    if isinstance(tyre, LinearTyre | BrushTyre | MagicFormulaTyre):
        return Planar(tyre.longitudinal_stiffness, tyre.cornering_stiffness)
    return Planar(tyre.longitudinal.initial_slope[0], tyre.lateral.initial_slope[0])


def push(tyre: Tyre, gain: Num, drift: Num) -> Planar:
    """How fast sliding builds up the deflection [1/s]: the tread gains on the ground to the rear and drifts left [m/s].

    Gain pulls the wheel forward, drift to the right.
    """
    C, per_length = nominal_stiffness(tyre), 1.0 / tyre.relaxation_length
    return Planar((C.x * per_length) * gain, (-C.y * per_length) * drift)


def size(of_push: Planar) -> Num:
    """Length of a push, never quite zero [1/s]."""
    return ca.sqrt(of_push.x**2 + (of_push.y**2 + _TINY))


def load_factor(tyre: LinearTyre | BrushTyre | MagicFormulaTyre, F_z: Num) -> Num:
    """Stiffness over load, over that at the nominal load [-]; it falls with load."""
    per_newton = tyre.load_sensitivity / tyre.nominal_load
    return ca.fmax((1.0 + tyre.load_sensitivity) - per_newton * F_z, _LEAST_STIFFNESS)


def trail_at(tyre: Tyre, F_z: Num, left: Num) -> Num:
    """Pneumatic trail [m] of which sliding has left a share; it grows with load as the tangent to the root does.

    The contact patch of a round tyre grows with the root of the load. Curves without a moment of their own leave the
    share of the largest force that is not in use: within 0.15 of what a brush leaves.
    """
    half = 0.5 * tyre.pneumatic_trail
    return (half + (half / tyre.nominal_load) * F_z) * left


def deflection_rate(n: Planar, pushed: Planar, fading: Num) -> Planar:
    """Rate of the deflection [1/s]."""
    return Planar(pushed.x - fading * n.x, pushed.y - fading * n.y)


def contact(n: Planar, n_rate: Planar, F_z: Num, grip: Grip, damping: Num) -> Contact:
    """Force of a deflected and deflecting tyre; never beyond its limit."""
    x = n.x + damping * n_rate.x
    y = grip.skew * (n.y + damping * n_rate.y)
    squares = grip.factor_by_limit**2
    demand = ca.fmax((x**2 + y**2) * squares, 1.0)  # squared, over the limit; at least 1
    scale = (F_z * grip.factor) / ca.sqrt(demand)
    return Contact(Planar(scale * x, scale * y), scale, x**2 * squares / demand)
