"""The chain's equations by name, and vehicles with other numbers, for tests."""

from typing import Any

import numpy as np

from vehicle.combination.chain import derivative, output
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import compiled
from vehicle.combination.layout import Input, Output, State, input_sizes, output_sizes, parts, state_sizes
from vehicle.combination.unit import Axle
from vehicle.frames import FloatArray
from vehicle.tyres.laws import LinearTyre


def named(vehicle: Vehicle, state: FloatArray) -> State[Any]:
    return State(*parts(state, state_sizes(vehicle)))


def at_rest(vehicle: Vehicle, **changes: FloatArray) -> tuple[State[Any], Input[Any]]:
    """State and input of the standing vehicle on dry, level ground, with changes of the input."""
    s = State(*(np.zeros(n) for n in state_sizes(vehicle)))
    u = Input(*(np.zeros(n) for n in input_sizes(vehicle)))
    return s, u._replace(**({"friction": np.full(vehicle.n_wheels, 0.8)} | changes))


def rates(vehicle: Vehicle, s: State[Any], u: Input[Any]) -> State[Any]:
    return named(vehicle, np.array(compiled(derivative, vehicle)(np.concatenate(s), np.concatenate(u))).ravel())


def outputs(vehicle: Vehicle, s: State[Any], u: Input[Any]) -> Output[Any]:
    y = np.array(compiled(output, vehicle)(np.concatenate(s), np.concatenate(u))).ravel()
    return Output(*parts(y, output_sizes(vehicle)))


def with_axles(vehicle: Vehicle, *changes: dict[str, Any], tyre: dict[str, Any] | None = None) -> Vehicle:
    """The vehicle with changes of each axle, front to rear, or of all alike, and of all their tyres."""
    each = iter(changes if len(changes) > 1 else [*(changes or [{}])] * vehicle.n_wheels)

    def changed(axle: Axle) -> Axle:
        own = {} if tyre is None else {"tyre": axle.tyre.model_copy(update=tyre)}
        return axle.model_copy(update=own | next(each))

    units = [unit.model_copy(update={"axles": tuple(changed(axle) for axle in unit.axles)}) for unit in vehicle.units]
    return vehicle.model_copy(update={"units": tuple(units)})


def grouped(vehicle: Vehicle) -> Vehicle:
    """The longer semi-trailer with one actuator for both steered axles, the second turned by half."""
    return with_axles(vehicle, {}, {}, {}, {"steer_group": "rear"}, {"steer_group": "rear", "steer_ratio": 0.5})


def linear_tyre(stiffness: float, axle_load: float, **changes: float) -> LinearTyre:
    """A tyre as textbooks have it: stiff in proportion to load, without rolling resistance and trail."""
    numbers = {
        "cornering_stiffness": stiffness, "longitudinal_stiffness": 15.0, "nominal_load": axle_load / 2,
        "load_sensitivity": 0.0, "relaxation_length": 0.5, "damping": 0.01, "rolling_resistance": 0.0,
        "pneumatic_trail": 0.0,
    }  # fmt: skip
    return LinearTyre.model_validate({"model": "linear"} | numbers | changes)
