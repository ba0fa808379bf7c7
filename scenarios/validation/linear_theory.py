"""Checks of the model's small motions against an audited linear model of the same combination."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.vehicles import linear_tyre, on_single_axles, with_tyres
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.handling import peak_rearward_amplification, rearward_amplification, understeer_gradient
from vehicle.combination.linear import LateralModel, lateral_model
from vehicle.combination.loads import static_axle_loads

_SPEED: Final = 24.0  # [m/s]
_STIFFNESS: Final = (280693.53, 581536.8, 970209.0)  # of the axles, front to rear [N/rad]
_MODES: Final = ((-2.46082646, 2.01398867), (-0.82568020, 2.21590363))  # real and imaginary part [1/s]
_AMPLIFICATION: Final = {0.1: 1.0381, 0.2: 1.1522, 0.3: 1.2569, 0.4: 1.0052, 0.5: 0.5772, 0.8: 0.3562, 1.0: 0.2657}
_AUDIT: Final = "audit of rl_path_planning's single-track model, and an independent recalculation"
_RELATIVE: Final = 1e-6  # relative tolerance of targets with nine digits


def linear_theory(quick: bool) -> Section:
    """Eigenvalues, gains and rearward amplification of the 40 t combination at 24 m/s."""
    vehicle = audited_vehicle()
    model = lateral_model(vehicle, _SPEED, outputs=("yaw_rate", "lateral_acceleration", "articulation"))
    return Section(
        title="Linear theory",
        text="The model's equations, linearised about straight running at 24 m/s with the assumptions of the audited "
        "single-track model: linear tyres without relaxation at their static loads, and one axle for the tridem.",
        checks=(*_modes(model), *_gains(vehicle, model), *_trailer_steer(vehicle), *_amplifications(vehicle)),
        plots=(_curve(vehicle),),
    )


def audited_vehicle() -> Vehicle:
    """European combination with exactly the audited masses, lengths and axle stiffnesses."""
    vehicle = on_single_axles(load_vehicle("eu_tractor_semitrailer"))
    loads = [float(load) for unit in static_axle_loads(vehicle) for load in unit]
    tyres = iter(
        [
            linear_tyre(C / load, 0.5 * load, relaxation_length=0.5, damping=0.0)
            for C, load in zip(_STIFFNESS, loads, strict=True)
        ]
    )
    units = tuple(with_tyres(unit, [next(tyres) for _ in unit.axles]) for unit in vehicle.units)
    return vehicle.model_copy(update={"units": units})


def _modes(model: LateralModel) -> tuple[Check, ...]:
    """Real and imaginary part of both modes; damping and frequency of the trailer's mode."""
    modes = [mode for mode in model.eigenvalues() if mode.imag > 0.0]
    rows = [
        (f"mode {k + 1}: {part}", value, target, "1/s")
        for k, (mode, (real, imaginary)) in enumerate(zip(modes, _MODES, strict=True))
        for part, value, target in (("real part", mode.real, real), ("imaginary part", mode.imag, imaginary))
    ]
    trailer = modes[-1]
    rows += [
        ("damping ratio of the trailer's mode", -trailer.real / abs(trailer), 0.349164, ""),
        ("undamped frequency of the trailer's mode", abs(trailer), 2.364736, "rad/s"),
    ]
    return tuple(_relative(name, float(value), target, unit) for name, value, target, unit in rows)


def _relative(name: str, value: float, target: float, unit: str) -> Check:
    return Check(name, value, unit, target=target, tolerance=_RELATIVE * abs(target), source=_AUDIT)


def _gains(vehicle: Vehicle, model: LateralModel) -> tuple[Check, ...]:
    gradient = math.degrees(understeer_gradient(vehicle, _SPEED) * GRAVITY)
    return (
        _relative("steady yaw rate over steer angle", model.steady_gain("yaw_rate_0"), 3.390708813, "1/s"),
        _relative(
            "steady articulation over steer angle", math.degrees(model.steady_gain("articulation_1")), 44.13828, "°/rad"
        ),
        Check(
            name="understeer gradient of the tractor",
            value=gradient,
            target=3.1989,
            tolerance=1e-4,  # given to four decimals
            unit="°/g",
            source=_AUDIT,
        ),
    )


def _trailer_steer(vehicle: Vehicle) -> tuple[Check, ...]:
    """The same combination with its trailer's axle steered."""
    tractor, trailer = vehicle.units
    steered = trailer.model_copy(
        update={"axles": (trailer.axles[0].model_copy(update={"steered": True}),), "steering": tractor.steering}
    )
    model = lateral_model(vehicle.model_copy(update={"units": (tractor, steered)}), _SPEED)
    rows = (("steady articulation over trailer steer", "articulation_1", 1.0, ""),
            ("steady yaw rate over trailer steer", "yaw_rate_0", 0.0, "1/s"))  # fmt: skip
    return tuple(
        Check(
            name,
            model.steady_gain(output, "trailer_steer_0"),
            unit,
            target=target,
            tolerance=_RELATIVE,
            source="in steady state the trailer's wheels run straight ahead, so its articulation equals their angle",
        )
        for name, output, target, unit in rows
    )


def _amplifications(vehicle: Vehicle) -> tuple[Check, ...]:
    """Lateral acceleration at the trailer's centre of gravity over that at the tractor's."""
    peak = peak_rearward_amplification(vehicle, _SPEED)
    at = rearward_amplification(vehicle, _SPEED, list(_AMPLIFICATION))
    return (
        _relative("largest rearward amplification", peak.gain, 1.257008, ""),
        Check(
            name="frequency of the largest rearward amplification",
            value=peak.frequency,
            target=0.2975,
            tolerance=1e-4,  # given to four decimals; a peak is flat
            unit="Hz",
            source=_AUDIT,
        ),
        *(
            Check(
                name=f"rearward amplification at {frequency:g} Hz",
                value=float(value),
                target=target,
                tolerance=6e-5,  # given to four decimals
                unit="",
                source=_AUDIT,
            )
            for (frequency, target), value in zip(_AMPLIFICATION.items(), at, strict=True)
        ),
    )


def _curve(vehicle: Vehicle) -> Plot:
    frequencies = np.linspace(0.02, 1.2, 300)
    audited_at, audited = np.array(list(_AMPLIFICATION.items())).T
    return Plot(
        title="Rearward amplification of lateral acceleration at 24 m/s",
        x_label="frequency [Hz]",
        y_label="amplification [-]",
        series=(
            Series("model", frequencies, rearward_amplification(vehicle, _SPEED, frequencies), "model"),
            Series("audit", audited_at, audited, "reference points"),
        ),
    )
