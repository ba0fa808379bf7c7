"""Checks of the tyre's lag: the force after a step of slip against its closed form, from 5 to 110 km/h.

The vehicle's motion is held and only its tyres' deflections are integrated, with the rates and forces of the plant's
equations. With sigma the relaxation length and V the speed the mean lag is the area between the step and the response.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.vehicles import linear_tyre, with_tyres
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.functions import compiled_derivative, compiled_output
from vehicle.combination.layout import Output, State, output_sizes, parts, state_sizes
from vehicle.combination.linear import straight_running
from vehicle.frames import FloatArray

Direction = Literal["side", "along"]
_DIRECTIONS: Final[tuple[Direction, ...]] = get_args(Direction)

SPEEDS: Final = (5.0, 20.0, 60.0, 90.0, 110.0)  # [km/h]
_SLIP: Final = 1e-3  # small, for linear tyres far from the friction limit
_LENGTH: Final = 0.5  # relaxation length [m]
_DAMPING: Final = 0.04  # of the carcass at rest, as of the shipped vehicles [s]
_STIFFNESS: Final = 6.0  # slip stiffness over load [-]
_STEPS_PER_LAG: Final = 20  # Runge-Kutta steps; their error is below 1e-7
_LAGS: Final = 15.0  # duration in lags: 3e-7 of the force is still missing


class StepResponse(NamedTuple):
    """Force after a step of slip at time 0."""

    time: FloatArray  # (n,) [s]
    force: FloatArray  # (n,) over the steady force [-]


def tyre_lag(quick: bool) -> Section:
    """Mean lag, overshoot and closed form of the force after a step of slip."""
    vehicle = vehicle_on_linear_tyres()
    cases = [(d, kmh, step_response(vehicle, kmh / 3.6, d)) for d in _DIRECTIONS for kmh in SPEEDS]
    return Section(
        title="Tyre lag",
        text="The slip of all wheels jumps by 0.001, along or across, with the vehicle's motion held. A tyre relaxes "
        "over its relaxation length, here 0.5 m, so the area between step and response times speed is that length.",
        checks=tuple(check for d, kmh, response in cases for check in _checks(d, kmh, response)),
        plots=(_plot([(kmh, response) for d, kmh, response in cases if d == "side"]),),
    )


def vehicle_on_linear_tyres() -> Vehicle:
    """Tractor on linear tyres with a damped carcass."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    tractor = vehicle.units[0]
    tyres = [
        linear_tyre(_STIFFNESS, axle.tyre.nominal_load, relaxation_length=_LENGTH, damping=_DAMPING)
        for axle in tractor.axles
    ]
    return vehicle.model_copy(update={"units": (with_tyres(tractor, tyres),)})


def step_response(vehicle: Vehicle, speed: float, direction: Direction) -> StepResponse:
    """Force of the first unit's tyres at a ``speed`` [m/s] after a step of slip."""
    sizes = state_sizes(vehicle)
    x, u = straight_running(vehicle, speed, 0.8)
    s = State(*parts(x, sizes))
    still = s._replace(deflection_x=0.0 * s.deflection_x, deflection_y=0.0 * s.deflection_y)
    stepped = (
        still._replace(v_y=still.v_y - _SLIP * speed)
        if direction == "side"
        else still._replace(omega=still.omega * (1.0 + _SLIP))
    )
    moving = np.concatenate(
        [np.full(n, name.startswith("deflection")) for name, n in zip(s._fields, sizes, strict=True)]
    )
    derivative, output = compiled_derivative(vehicle), compiled_output(vehicle)

    def rate(state: FloatArray) -> FloatArray:
        return np.where(moving, np.array(derivative(state, u)).ravel(), 0.0)

    def force(state: FloatArray) -> float:
        out = Output(*parts(np.array(output(state, u)).ravel(), output_sizes(vehicle)))
        return float((out.force_y if direction == "side" else out.force_x)[0])

    lag = _LENGTH / speed
    h = lag / _STEPS_PER_LAG
    state, forces = np.concatenate(stepped), []
    count = round(_LAGS * (lag + _DAMPING) / h)
    for _ in range(count + 1):
        forces.append(force(state))
        k_1 = rate(state)
        k_2 = rate(state + 0.5 * h * k_1)
        k_3 = rate(state + 0.5 * h * k_2)
        k_4 = rate(state + h * k_3)
        state = state + h / 6.0 * (k_1 + 2.0 * (k_2 + k_3) + k_4)
    steady = forces[-1]
    return StepResponse(h * np.arange(count + 1, dtype=np.float64), np.array(forces) / steady)


def mean_lag(response: StepResponse) -> float:
    """Area between step and response [s]."""
    return float(np.trapezoid(1.0 - response.force, response.time))


def closed_form(direction: Direction, speed: float, time: FloatArray) -> FloatArray:
    """Force over the steady one: first order across the wheel, along it in series with the damped carcass.

    Along, the force is n + d n' with n' = (1 - n) w / (1 + d w) and w = V / sigma, n over its steady value.
    """
    w = speed / _LENGTH
    late = 1.0 / (1.0 + _DAMPING * w) if direction == "along" else 1.0
    response: FloatArray = 1.0 - late * np.exp(-w * late * time)
    return response


def _checks(direction: Direction, kmh: float, response: StepResponse) -> tuple[Check, ...]:
    where = f"{'across' if direction == 'side' else 'along'} the wheel, {kmh:g} km/h"
    speed = kmh / 3.6
    off = response.force - closed_form(direction, speed, response.time)
    return (
        Check(
            f"mean lag times speed {where}",
            mean_lag(response) * speed,
            "m",
            target=_LENGTH,
            tolerance=0.02 * _LENGTH,  # what issue 18 asks for; the trapezoidal rule takes 1e-4 of it
            source="definition of the relaxation length",
        ),
        Check(
            f"overshoot {where}",
            float(response.force.max()) - 1.0,
            "",
            target=0.0,
            tolerance=1e-6,  # the part of the steady force that is still missing at the end
            source="a relaxing tyre approaches its steady force from below",
        ),
        Check(
            f"largest deviation of the response {where}",
            float(np.abs(off).max()),
            "",
            target=0.0,
            tolerance=1e-5,  # numerical integration, and the part that is still missing at the end
            source="solution of the first-order equation",
        ),
    )


def _plot(cases: list[tuple[float, StepResponse]]) -> Plot:
    kmh, response = cases[-2]
    time = response.time[response.time < 0.15]
    series = [
        Series(f"{kmh:g} km/h", response.time[: len(time)], response.force[: len(time)], "model"),
        Series("closed form", time[::5], closed_form("side", kmh / 3.6, time[::5]), "reference points"),
    ]
    return Plot(
        title="Side force after a step of slip angle",
        x_label="time [s]",
        y_label="force over steady force [-]",
        series=tuple(series),
    )
