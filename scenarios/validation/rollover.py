"""Rollover thresholds: by the roll-plane equations, by energy, on the tilt table, and in a closing curve."""

from __future__ import annotations

from typing import Final

import numpy as np

from scenarios.standards.closing_curve import closing_curve
from scenarios.standards.tilt import tilt
from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.roll_energy import rollover_by_energy
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.load_cases import with_load
from vehicle.combination.rollover import static_rollover

_QUICK: Final = ("eu_tractor_semitrailer", "b_double", "a_double", "rigid_truck")
_OTHERS: Final = ("desaxe_field_combination", "us_5_axle", "wb67", "uk_longer_semitrailer", "rigid_truck_8x4")
_DRIVEN: Final = ("eu_tractor_semitrailer", "rigid_truck", "a_double", "us_5_axle")
_LOADS: Final = ("full", "half")
_ENERGY: Final = "minimum of the potential energy, finite angles, unilateral tyre springs; 2 %: small angles"
_TABLE: Final = (
    "minimum of the potential energy on the slope; 4 %: the plant's axles roll as under their load on the level (2 %), "
    "and at 1° per second the bodies swing past their equilibrium (2 %)"
)
_CURVE: Final = "the tilt table; 8 %: in the curve axles share side forces by slip, and units have different radii"


def rollover(quick: bool) -> Section:
    """Thresholds of several vehicles and loads by the model and by an independent calculation, and on the plant."""
    vehicles = [load_vehicle(name) for name in (_QUICK if quick else (*_QUICK, *_OTHERS))]
    cases = [(f"{v.name}, {load}", with_load(v, load)) for v in vehicles for load in _LOADS]
    model = [static_rollover(vehicle).threshold / GRAVITY for _, vehicle in cases]
    energy = [rollover_by_energy(vehicle) / GRAVITY for _, vehicle in cases]
    driven = [load_vehicle(name) for name in (_DRIVEN[:1] if quick else _DRIVEN)]
    return Section(
        title="Rollover",
        text="The lateral acceleration that tips a combination: by the model's equations of roll, and by an "
        "independent calculation that searches the minimum of the potential energy. On the plant it is tilted, and "
        "steered slowly further into a curve, until it falls.",
        checks=(
            *(
                Check(
                    f"{name}: static rollover threshold",
                    value,
                    "g",
                    target=target,
                    tolerance=0.02 * target,
                    source=_ENERGY,
                )
                for (name, _), value, target in zip(cases, model, energy, strict=True)
            ),
            _audited(model[0]),
            *(check for vehicle in driven for check in _on_the_plant(vehicle)),
        ),
        plots=(_plot(np.array(energy), np.array(model)),),
    )


def _audited(threshold: float) -> Check:
    return Check(
        "eu_tractor_semitrailer: static rollover threshold against the audit of its data",
        threshold,
        "g",
        target=0.366,
        tolerance=0.04,
        source="0.70 of half the track over the height, the audit's own rule for the give of springs and tyres",
    )


def _on_the_plant(vehicle: Vehicle) -> tuple[Check, ...]:
    slope = rollover_by_energy(vehicle, on_table=True) / GRAVITY
    tilted = tilt(vehicle).figures["rollover_threshold_g"]
    curved = closing_curve(vehicle).figures["curve_rollover_g"]
    return (
        Check(f"{vehicle.name}: on the tilt table", tilted, "g", target=slope, tolerance=0.04 * slope, source=_TABLE),
        Check(
            f"{vehicle.name}: in a closing curve", curved, "g", target=tilted, tolerance=0.08 * tilted, source=_CURVE
        ),
    )


def _plot(energy: np.ndarray, model: np.ndarray) -> Plot:
    diagonal = np.array([0.9 * energy.min(), 1.05 * energy.max()])
    return Plot(
        title="Static rollover thresholds",
        x_label="by energy [g]",
        y_label="by the model [g]",
        series=(
            Series("equal", diagonal, diagonal, "reference"),
            Series("vehicles and loads", energy, model, "model points"),
        ),
        to_scale=True,
    )
