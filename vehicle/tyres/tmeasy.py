"""TMeasy: curves through initial slope, peak and sliding, each interpolated over load. For numbers or ``casadi.SX``.

Rill's tyre model, as published with Project Chrono: up to the peak (s < s_M, t = s / s_M) F = s dF0 / (1 + t (t +
dF0 s_M / F_M - 2)); from there a cubic to the sliding force at s_S. Friction stretches the curves: forces and slips of
peak and sliding go with friction over reference friction, the initial slope stays. Slips of both directions combine
as the linear forces they would cause, and the parameters blend with the squared cosines of that force's direction.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from vehicle.tyres.bristle import Grip, Num, Planar, size, trail_at
from vehicle.tyres.data import TmeasyCurve, TmeasyTyre


class _Curve(NamedTuple):
    """One direction's curve at a load; slips are given as the linear force over load that they would cause."""

    peak: Num  # where
    peak_force: Num
    sliding: Num  # where
    sliding_force: Num


def tmeasy_grip(tyre: TmeasyTyre, F_z: Num, friction: Num, pushed: Planar, speed: Num) -> Grip:
    """Grip of a TMeasy tyre."""
    # The tables' straight line over load, held beyond twice the nominal load.
    beyond = ca.fmin(F_z * (1.0 / tyre.nominal_load), 2.0) - 1.0
    k = friction * (1.0 / tyre.reference_friction)
    slopes = [_line(curve.initial_slope, beyond) for curve in (tyre.longitudinal, tyre.lateral)]
    factors = Planar(slopes[0] / tyre.longitudinal.initial_slope[0], slopes[1] / tyre.lateral.initial_slope[0])
    along, across = _at(tyre.longitudinal, slopes[0], beyond, k), _at(tyre.lateral, slopes[1], beyond, k)
    linear = Planar(factors.x * pushed.x, factors.y * pushed.y)
    pull = size(linear)
    share = (linear.x / pull) ** 2  # squared cosine of the direction
    curve = _Curve(*(b + share * (a - b) for a, b in zip(along, across, strict=True)))
    demand = tyre.relaxation_length * (pull / speed)
    force = _force(curve, demand)
    limit = ca.fmax(along.peak_force, across.peak_force)
    return Grip(
        fading=pull / force,
        limit=limit,
        factor=factors.x,
        skew=factors.y / factors.x,
        factor_by_limit=factors.x / limit,
        trail=trail_at(tyre, F_z, 1.0 - force / curve.peak_force),
    )


def _line(values: tuple[float, float], beyond: Num) -> Num:
    """What goes through two values at the nominal load and twice of it, at a load ``beyond`` it (in nominal loads)."""
    return values[0] + (values[1] - values[0]) * beyond


def _at(curve: TmeasyCurve, slope: Num, beyond: Num, k: Num) -> _Curve:
    """The curve at a load, stretched by friction k."""
    return _Curve(
        peak=k * slope * _line(curve.peak_slip, beyond),
        peak_force=k * _line(curve.peak_force, beyond),
        sliding=k * slope * _line(curve.sliding_slip, beyond),
        sliding_force=k * _line(curve.sliding_force, beyond),
    )


def _force(curve: _Curve, demand: Num) -> Num:
    """Force over load [-] at the linear force ``demand``."""
    t = ca.fmin(demand / curve.peak, 1.0)
    rise = curve.peak * t / (1.0 + t * (t + curve.peak / curve.peak_force - 2.0))
    f = ca.fmax(ca.fmin((demand - curve.peak) / (curve.sliding - curve.peak), 1.0), 0.0)
    return rise - (curve.peak_force - curve.sliding_force) * (f**2 * (3.0 - 2.0 * f))
