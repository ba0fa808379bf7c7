"""Simplified vehicles for comparison with theory: single axles, very stiff tyres, given lengths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from vehicle.combination.description import Vehicle
from vehicle.combination.unit import Axle, Unit
from vehicle.tyres.linear import LinearTyre

_STIFFEST: Final = 60.0  # slip stiffness over load [-]: ten times a truck tyre's, the largest valid value


def on_single_axles(vehicle: Vehicle) -> Vehicle:
    """Replace the unsteered axles of every unit by one in their middle, as in design vehicles and closed forms."""
    return vehicle.model_copy(update={"units": tuple(_on_single_axle(unit) for unit in vehicle.units)})


def gripping(vehicle: Vehicle) -> Vehicle:
    """Replace the tyres by ten times stiffer ones without rolling resistance, which hardly slip."""
    return vehicle.model_copy(update={"units": tuple(_gripping(unit) for unit in vehicle.units)})


def tractor_and_trailer(
    vehicle: Vehicle,
    *,
    length: float,
    hitch_x: float,
    wheelbase: float | None = None,
    rear: float | None = None,
    follow: float | None = None,
    width: float | None = None,
) -> Vehicle:
    """First two units of a vehicle on single axles, with the trailer's axle ``length`` behind the hitch [m].

    Centres of gravity move with the axles. ``rear`` and ``follow`` are the distances of the body's end and the follow
    point behind the hitch [m]. Values that are not given are kept.
    """
    tractor, trailer = on_single_axles(vehicle).units[:2]
    front, *driven = tractor.axles
    if wheelbase is not None:
        moved = wheelbase - front.x
        cg_x = tractor.cg_x * wheelbase / front.x
        tractor = tractor.model_copy(update={"front_x": tractor.front_x + moved, "cg_x": cg_x})
        front = front.model_copy(update={"x": wheelbase})
    tractor = tractor.model_copy(update={"hitch_x": hitch_x, "axles": (front, *driven)})
    trailer = trailer.model_copy(
        update={
            "axles": (trailer.axles[0].model_copy(update={"x": -length}),),
            "cg_x": trailer.cg_x * -length / trailer.axles[0].x,
            "rear_x": trailer.rear_x if rear is None else -rear,
            "follow_x": trailer.follow_x if follow is None else -follow,
            "width": trailer.width if width is None else width,
        }
    )
    return vehicle.model_copy(update={"units": (tractor, trailer)})


def with_steered_trailer(vehicle: Vehicle, distances: Sequence[float], follow: float) -> Vehicle:
    """Steer all axles of the trailer, ``distances`` behind the hitch; the follow point is ``follow`` behind it [m].

    The wheels' axes meet abreast of the point halfway to the follow point: the turning centre of path following.
    """
    tractor, trailer = vehicle.units[:2]
    axle = trailer.axles[-1].model_copy(update={"steered": True, "steer_group": None, "ackermann_x": -0.5 * follow})
    axles = tuple(axle.model_copy(update={"x": -distance}) for distance in distances)
    trailer = trailer.model_copy(update={"axles": axles, "follow_x": -follow})
    return vehicle.model_copy(update={"units": (tractor, trailer)})


def _on_single_axle(unit: Unit) -> Unit:
    fixed = [axle for axle in unit.axles if not axle.steered]
    axles = [axle for axle in unit.axles if axle.steered] + ([_merged(fixed)] if fixed else [])
    return unit.model_copy(update={"axles": tuple(sorted(axles, key=lambda axle: -axle.x)), "lifted_axles": ()})


def _merged(axles: Sequence[Axle]) -> Axle:
    """One axle in the middle of several, which carries their total load."""
    n = len(axles)
    middle = axles[n // 2]
    return middle.model_copy(
        update={
            "x": float(np.mean([axle.x for axle in axles])),
            "driven": any(axle.driven for axle in axles),
            "wheel_inertia": sum(axle.wheel_inertia for axle in axles),
            "tyre": middle.tyre.model_copy(update={"nominal_load": sum(axle.tyre.nominal_load for axle in axles)}),
            "bogie": None,
            "load_share": 1.0,
        }
    )


def _gripping(unit: Unit) -> Unit:
    return unit.model_copy(
        update={"axles": tuple(axle.model_copy(update={"tyre": _stiff(axle)}) for axle in unit.axles)}
    )


def _stiff(axle: Axle) -> LinearTyre:
    tyre = axle.tyre
    return linear_tyre(_STIFFEST, tyre.nominal_load, relaxation_length=tyre.relaxation_length, damping=tyre.damping)


def linear_tyre(stiffness: float, load: float, *, relaxation_length: float, damping: float) -> LinearTyre:
    """A linear tyre with a slip stiffness over load [-], without rolling resistance and pneumatic trail."""
    return LinearTyre(
        model="linear",
        cornering_stiffness=stiffness,
        longitudinal_stiffness=stiffness,
        nominal_load=load,
        load_sensitivity=0.0,
        relaxation_length=relaxation_length,
        damping=damping,
        rolling_resistance=0.0,
        pneumatic_trail=0.0,
    )


def with_tyres(unit: Unit, tyres: Sequence[LinearTyre]) -> Unit:
    """The unit with these tyres on its axles, front to rear."""
    axles: tuple[Axle, ...] = tuple(
        axle.model_copy(update={"tyre": tyre}) for axle, tyre in zip(unit.axles, tyres, strict=True)
    )
    return unit.model_copy(update={"axles": axles})
