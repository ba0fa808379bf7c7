"""Tyre data, one model per law: what a table ``[tyres.name]`` of a vehicle file says.

A twin wheel counts as one. Stiffnesses and forces are over the vertical load.
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, model_validator

from vehicle.quantities import Frozen, quantity

Stiffness = Annotated[float, quantity("-", gt=0.0, le=60.0)]  # per unit of slip (tangent of the slip angle)
OverLoad = Annotated[float, quantity("-", gt=0.0, le=2.0)]
Slip = Annotated[float, quantity("-", gt=0.0, le=5.0)]


class _Carcass(Frozen):
    """Data common to every law."""

    name: str = ""  # of its table in the vehicle file
    nominal_load: Annotated[float, quantity("N", gt=0.0, le=1e6)]  # per wheel
    relaxation_length: Annotated[float, quantity("m", gt=0.0, le=3.0)]
    damping: Annotated[float, quantity("s", ge=0.0, le=0.2)]  # of the carcass: damping over stiffness
    rolling_resistance: Annotated[float, quantity("-", ge=0.0, le=0.3)]  # rolling drag over load
    pneumatic_trail: Annotated[float, quantity("m", ge=0.0, le=0.3)]  # at small slip and nominal load; 0: no moment


class _Linear(_Carcass):
    cornering_stiffness: Annotated[float, quantity("1/rad", gt=0.0, le=60.0)]  # at the nominal load
    longitudinal_stiffness: Stiffness  # at the nominal load
    load_sensitivity: Annotated[float, quantity("-", ge=0.0, le=1.0)]  # relative loss of stiffness, per nominal load

    def with_cornering_scaled(self, factor: float) -> dict[str, object]:
        """Fields of this tyre with the cornering stiffness multiplied by ``factor``, for validation."""
        return self.model_dump() | {"cornering_stiffness": factor * self.cornering_stiffness}


class LinearTyre(_Linear):
    """Force in proportion to slip up to the friction circle."""

    model: Literal["linear"]


class BrushTyre(_Linear):
    """Elastic bristles under a parabolic pressure."""

    model: Literal["brush"]


class MagicFormulaTyre(_Linear):
    """Sine of an arc tangent, with the peak at friction times load."""

    model: Literal["magic_formula"]
    shape: Annotated[float, quantity("-", ge=1.0, le=2.0)]  # C; at 1 the force never falls off
    curvature: Annotated[float, quantity("-", ge=-10.0, le=1.0)]  # E


class TmeasyCurve(Frozen):
    """Force over slip in one direction, each number at the nominal load and at twice of it."""

    initial_slope: tuple[Stiffness, Stiffness]
    peak_slip: tuple[Slip, Slip]
    peak_force: tuple[OverLoad, OverLoad]
    sliding_slip: tuple[Slip, Slip]
    sliding_force: tuple[OverLoad, OverLoad]

    @model_validator(mode="after")
    def _a_curve(self) -> TmeasyCurve:
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


class TmeasyTyre(_Carcass):
    """Curves through initial slope, peak and sliding (Rill's TMeasy), stretched with friction."""

    model: Literal["tmeasy"]
    reference_friction: Annotated[float, quantity("-", gt=0.0, le=2.0)]  # of the ground the curves are given for
    lateral: TmeasyCurve
    longitudinal: TmeasyCurve

    def with_cornering_scaled(self, factor: float) -> dict[str, object]:
        """Fields of this tyre with the lateral initial slopes multiplied by ``factor``, for validation.

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


Tyre: TypeAlias = Annotated[
    LinearTyre | BrushTyre | MagicFormulaTyre | TmeasyTyre,
    Field(discriminator="model"),
]
TYRES: dict[str, type[LinearTyre | BrushTyre | MagicFormulaTyre | TmeasyTyre]] = {
    "linear": LinearTyre,
    "brush": BrushTyre,
    "magic_formula": MagicFormulaTyre,
    "tmeasy": TmeasyTyre,
}
