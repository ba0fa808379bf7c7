"""Laws of the steady tyre force, and their catalogue by the name that a vehicle file gives as model.

Friction scales the peak and leaves the stiffness: with the linear force over friction as argument there is one curve.

TMeasy is Rill's tyre model, as published with Project Chrono: up to the peak (s < s_M, t = s / s_M) F = s dF0 / (1 + t
(t + dF0 s_M / F_M - 2)); from there a cubic to the sliding force at s_S. Friction stretches the curves: forces and
slips of peak and sliding go with friction over reference friction, the initial slope stays. Slips of both directions
combine as the linear forces they would cause, and the parameters blend with the squared cosines of that force's
direction.
"""

from collections.abc import Mapping
from typing import Annotated, Final, Literal, NamedTuple

import casadi as ca
from pydantic import model_validator

from vehicle.foundation.quantity import Frozen, quantity
from vehicle.tyres.tyre import Grip, Num, Planar, Stiffness, StiffnessTyre, Tyre, magnitude, slip_speed


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


class BrushTyre(StiffnessTyre):
    """Elastic bristles under a parabolic pressure."""

    model: Literal["brush"]

    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """With t the sliding share of the patch, 1 - (1 - t)^3 of friction times load is used.

        The moment is the trail times the linear force, reduced by the same share: 1 - used times 3 t over used.
        """
        # With the slip over ``slip_speed``, t is the smaller of sigma / 3 * slip and 1: the pull over the larger of
        # 3 / sigma * speed and the pull itself, at every speed and at rest.
        factor = self.load_factor(F_z)
        by_limit = factor * (1.0 / friction)
        pull = by_limit * magnitude(sliding)
        most = ca.fmax((3.0 / self.relaxation_length) * speed, pull)
        t = pull / most
        per_share = 1.0 / (3.0 - t * (3.0 - t))  # t over the share of the limit that is used
        return Grip(most * per_share, friction, factor, 1.0, by_limit, self.trail(F_z, 3.0 * (per_share - t)))


class MagicFormulaTyre(StiffnessTyre):
    """Sine of an arc tangent, with the peak at friction times load."""

    model: Literal["magic_formula"]
    # C; at 1 the force never falls off
    shape: float = quantity(..., "-", 1.0, 2.0, why="1 never falls off; beyond 2 the force would turn round")
    curvature: float = quantity(..., "-", -10.0, 1.0, why="beyond 1 the curve has no single peak")  # E

    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """Pacejka's formula without offsets, with the peak at friction times load."""
        factor = self.load_factor(F_z)
        by_limit = factor * (1.0 / friction)
        pull = by_limit * magnitude(sliding)
        slip = pull / slip_speed(speed, pull, self.relaxation_length)
        x = (self.relaxation_length / self.shape) * slip
        used = ca.sin(self.shape * ca.atan((1.0 - self.curvature) * x + self.curvature * ca.atan(x)))
        return Grip(pull / used, friction, factor, 1.0, by_limit, self.trail(F_z, 1.0 - used))


OverLoad = Annotated[float, quantity(..., "-", 0.0, 2.0, above=True, why="tyres hold 0.4 to 1.5 times their load")]
Slip = Annotated[
    float, quantity(..., "-", 0.0, 5.0, above=True, why="forces peak at a slip of 0.05 to 0.5 and slide at 1")
]


class TmeasyCurve(Frozen):
    """Force over slip in one direction, each number at the nominal load and at twice of it."""

    initial_slope: tuple[Stiffness, Stiffness]
    peak_slip: tuple[Slip, Slip]
    peak_force: tuple[OverLoad, OverLoad]
    sliding_slip: tuple[Slip, Slip]
    sliding_force: tuple[OverLoad, OverLoad]

    @model_validator(mode="after")
    def _is_convex(self) -> "TmeasyCurve":
        for k, load in enumerate(("the nominal load", "twice the nominal load")):
            if self.sliding_slip[k] <= self.peak_slip[k]:
                raise ValueError(
                    f"sliding_slip = {self.sliding_slip[k]:g} must be beyond "
                    f"peak_slip = {self.peak_slip[k]:g} at {load}"
                )
            if self.sliding_force[k] > self.peak_force[k]:
                raise ValueError(
                    f"sliding_force = {self.sliding_force[k]:g} must not exceed "
                    f"peak_force = {self.peak_force[k]:g} at {load}"
                )
            if self.initial_slope[k] * self.peak_slip[k] < 2.0 * self.peak_force[k]:
                raise ValueError(
                    f"initial_slope = {self.initial_slope[k]:g} must be at least 2 peak_force / peak_slip = "
                    f"{2.0 * self.peak_force[k] / self.peak_slip[k]:g} at {load}, or the curve is not convex"
                )
        return self


class TmeasyTyre(Tyre):
    """Curves through initial slope, peak and sliding, stretched with friction."""

    model: Literal["tmeasy"]
    # Of the ground the curves are given for
    reference_friction: float = quantity(..., "-", 0.0, 2.0, above=True, why="ice has 0.05, rubber on asphalt 1")
    lateral: TmeasyCurve
    longitudinal: TmeasyCurve

    @property
    def nominal_stiffness(self) -> Planar:
        """Slip stiffness over load along and across the wheel at the nominal load [-]."""
        return Planar(self.longitudinal.initial_slope[0], self.lateral.initial_slope[0])

    def with_cornering_scaled(self, factor: float) -> dict[str, object]:
        """Fields of this tyre with the lateral initial slopes multiplied by ``factor``.

        The slips of peak and sliding are divided by it, as in the other laws: the curve is compressed along the slip
        axis, and keeps its shape and its forces.
        """
        curve = self.lateral
        lateral = curve.model_dump() | {
            "initial_slope": [factor * slope for slope in curve.initial_slope],
            "peak_slip": [slip / factor for slip in curve.peak_slip],
            "sliding_slip": [slip / factor for slip in curve.sliding_slip],
        }
        return self.model_dump() | {"lateral": lateral}

    def grip(self, F_z: Num, friction: Num, sliding: Planar, speed: Num) -> Grip:
        """Curves of both directions at this load, blended by the direction of the linear force."""
        # The tables' straight line over load, held beyond twice the nominal load.
        beyond = ca.fmin(F_z * (1.0 / self.nominal_load), 2.0) - 1.0
        k = friction * (1.0 / self.reference_friction)
        slopes = [_line(curve.initial_slope, beyond) for curve in (self.longitudinal, self.lateral)]
        factors = Planar(slopes[0] / self.longitudinal.initial_slope[0], slopes[1] / self.lateral.initial_slope[0])
        along, across = _at(self.longitudinal, slopes[0], beyond, k), _at(self.lateral, slopes[1], beyond, k)
        linear = Planar(factors.x * sliding.x, factors.y * sliding.y)
        pull = magnitude(linear)
        share = (linear.x / pull) ** 2  # squared cosine of the direction
        curve = _LoadedCurve(*(b + share * (a - b) for a, b in zip(along, across, strict=True)))
        limit = ca.fmax(along.peak_force, across.peak_force)
        by_limit = 1.0 / limit
        demand = self.relaxation_length * (pull / slip_speed(speed, by_limit * pull, self.relaxation_length))
        force = _force(curve, demand)
        return Grip(
            decay=pull / force,
            limit=limit,
            factor=factors.x,
            skew=factors.y / factors.x,
            factor_by_limit=factors.x * by_limit,
            trail=self.trail(F_z, 1.0 - force / curve.peak_force),
        )


class _LoadedCurve(NamedTuple):
    """One direction's curve at a load; slips are given as the linear force over load that they would cause."""

    peak: Num  # slip at the largest force
    peak_force: Num
    sliding: Num  # slip from which on the whole patch slides
    sliding_force: Num


def _line(values: tuple[float, float], beyond: Num) -> Num:
    """Linear interpolation between values at the nominal load and at twice of it; ``beyond`` in nominal loads above."""
    return values[0] + (values[1] - values[0]) * beyond


def _at(curve: TmeasyCurve, slope: Num, beyond: Num, k: Num) -> _LoadedCurve:
    """The curve at a load, stretched by friction k."""
    return _LoadedCurve(
        peak=k * slope * _line(curve.peak_slip, beyond),
        peak_force=k * _line(curve.peak_force, beyond),
        sliding=k * slope * _line(curve.sliding_slip, beyond),
        sliding_force=k * _line(curve.sliding_force, beyond),
    )


def _force(curve: _LoadedCurve, demand: Num) -> Num:
    """Force over load [-] at the linear force ``demand``."""
    t = ca.fmin(demand / curve.peak, 1.0)
    rise = curve.peak * t / (1.0 + t * (t + curve.peak / curve.peak_force - 2.0))
    f = ca.fmax(ca.fmin((demand - curve.peak) / (curve.sliding - curve.peak), 1.0), 0.0)
    return rise - (curve.peak_force - curve.sliding_force) * (f**2 * (3.0 - 2.0 * f))


TYRES: Final[Mapping[str, type[Tyre]]] = {
    "linear": LinearTyre,
    "brush": BrushTyre,
    "magic_formula": MagicFormulaTyre,
    "tmeasy": TmeasyTyre,
}


def tyre_law(name: object) -> type[Tyre] | None:
    """Law of this name, that of tyre files included, whose many fields are built when one is used; None: no law."""
    if name == "tyre_file":
        from vehicle.tyres.magic_formula import PropertyFileTyre

        return PropertyFileTyre
    return TYRES.get(str(name))
