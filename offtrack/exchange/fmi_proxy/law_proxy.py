"""Trailer steering laws as FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from controllers.driver import PERIOD as CONTROL_PERIOD
from controllers.trailer import Combination
from controllers.trailer_steering.safeguarded import Degradation
from offtrack.exchange.fmi_export.variables import Quantity
from offtrack.exchange.fmi_import.numbered_signals import (
    NO_ESTIMATE,
    estimate_of,
    estimate_signals,
    reading_of,
    reading_signals,
)
from offtrack.exchange.fmi_proxy.proxy import Computation, Opening, Proxy, quantity
from scenarios.assembly.adapters import trailer_geometry, vehicle_of
from scenarios.assembly.drivers_and_laws import (
    bare_law,
    law_uses_off_tracking,
    steering_parameters,
    trailer_law,
)
from scenarios.catalogue import TRAILER_STEERING, resolve
from scenarios.loop.channel import CONTROL
from scenarios.options.scenario import Scenario
from vehicle.clock import Schedule, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.foundation.own_parts import close_part
from vehicle.option import Option, Parameter, declared_options

GUARDED: Final = "guarded"  # parameter: 1 with the guard against bad estimates, 0 without
_DEGRADATION: Final = "degradation."
_FIRST: Final = "first_step"


def steered_unit(vehicle: Vehicle) -> int:
    """Index of the last trailer with steered axles.

    Raises:
        ValueError: one line, if there is none.
    """
    steered = [unit for unit, one in enumerate(vehicle.units) if unit > 0 and one.steered_axles]
    if not steered:
        raise ValueError(f"vehicle {vehicle.name}: no axle of a trailer is steered; choose another --vehicle")
    return steered[-1]


def law_of_scenario(scenario: Scenario, first_step: float = 0.0, unit: int | None = None) -> Proxy:
    """The scenario's law as an FMU, with its first step at a time [s], for a unit or the last steered trailer.

    Raises:
        ValueError: one line, if it can't be constructed for the vehicle.
    """
    given = steering_parameters(scenario)
    return law_proxy(scenario.trailer_steering, vehicle_of(scenario), given, scenario.degradation, first_step, unit)


def law_proxy(
    name: str,
    vehicle: Vehicle,
    given: Mapping[str, Parameter],
    degradation: Degradation | None = None,
    first_step: float = 0.0,
    unit: int | None = None,
) -> Proxy:
    """A law for a trailer of a vehicle.

    Its parameters are the numbers among the law's options, and the limits of its guard.

    Args:
        name: in the catalogue, or ``package.module:Name``.
        vehicle: the data sheet that it goes by.
        given: values of its options; texts are fixed, and files that they name go into the FMU.
        degradation: limits of the guard.
        first_step: time of the law's first step [s].
        unit: index of the trailer; None: the last steered one.

    Raises:
        ValueError: one line, if there is no such law or it can't be constructed.
    """
    if name.endswith(".fmu"):
        raise ValueError(f"{name}: is an FMU already")
    unit = steered_unit(vehicle) if unit is None else unit
    trailer, combination = trailer_geometry(vehicle, unit), Combination(vehicle, unit)
    limits = degradation or Degradation()
    close_part(trailer_law(name, trailer, combination, given, limits))  # checks everything
    options = declared_options(resolve("trailer_steering", name, TRAILER_STEERING), or_keywords=True)
    numbers = [_parameter(option, given) for option in options if _is_number(option, given)]
    fixed = {key: value for key, value in given.items() if key not in {one.name for one in numbers}}
    files = {Path(str(value)).name: Path(str(value)).read_bytes() for value in fixed.values() if _is_file(value)}
    guard = _guard_parameters(limits) if law_uses_off_tracking(name) else []
    n_units, axles = len(vehicle.units), range(1, len(trailer.steered_distances) + 1)
    inputs = (*estimate_signals(coarse=False), *reading_signals(len(axles), n_units))
    return Proxy(
        kind="law",
        name=f"{name.rpartition(':')[2]}_{vehicle.name}",
        summary=f"trailer steering law {name} of offtrack for {vehicle.name}",
        inputs=[quantity(signal, NO_ESTIMATE.get(signal.name, 0.0)) for signal in inputs],
        outputs=[
            Quantity(f"steer_demand_{k}", "rad", f"of steered axle {k} of the trailer, + left") for k in axles
        ],
        parameters=[
            *numbers,
            *guard,
            Quantity(_FIRST, "s", "time of the law's first step, a whole number of milliseconds", first_step, 0.0, 1.0),
        ],
        settings={
            "law": name,
            "vehicle": vehicle.model_dump(mode="json"),
            "unit": unit,
            "fixed": {key: {"file": Path(str(value)).name} if _is_file(value) else value
                      for key, value in fixed.items()},
            "fallback": limits.fallback,
        },
        files=files,
        notes=(
            f"The law acts every {1e3 * CONTROL_PERIOD:g} ms; its demands are there at the end of the step in which it "
            "does. Communication steps are whole numbers of milliseconds; inputs hold during one.",
        ),
        step=CONTROL_PERIOD,
    )  # fmt: skip


def _is_number(option: Option, given: Mapping[str, Parameter]) -> bool:
    value = given.get(option.name, option.default)
    return isinstance(value, int | float) and not isinstance(value, bool) and option.kind is float


def _parameter(option: Option, given: Mapping[str, Parameter], prefix: str = "") -> Quantity:
    value = given.get(option.name, option.default)
    assert isinstance(value, int | float)
    return Quantity(prefix + option.name, option.unit, option.meaning, float(value), option.low, option.high)


def _is_file(value: Parameter) -> bool:
    return isinstance(value, str) and Path(value).is_file()


def _guard_parameters(degradation: Degradation) -> list[Quantity]:
    given = degradation.model_dump()
    numbers = [option for option in declared_options(Degradation) if _is_number(option, given)]
    limits = [_parameter(option, given, _DEGRADATION) for option in numbers]
    return [Quantity(GUARDED, "-", "1 with the guard against bad estimates, 0 without", 1.0, 0.0, 1.0), *limits]


class LawComputation(Computation):
    """A law in the process of its FMU."""

    def __init__(self, opening: Opening) -> None:
        """Construct the law.

        Raises:
            ValueError: one line, for a parameter outside its limits.
        """
        settings, parameters = opening.settings, dict(opening.parameters)
        vehicle, unit, name = Vehicle.model_validate(settings["vehicle"]), int(settings["unit"]), settings["law"]
        law = resolve("trailer_steering", name, TRAILER_STEERING)
        options = {option.name for option in declared_options(law, or_keywords=True)}
        given: dict[str, Parameter] = {key: value for key, value in parameters.items() if key in options}
        given |= {key: _value(value, opening.folder) for key, value in settings["fixed"].items()}
        trailer, combination = trailer_geometry(vehicle, unit), Combination(vehicle, unit)
        if parameters.get(GUARDED, 1.0) >= 0.5:
            of_guard = [key for key in parameters if key.startswith(_DEGRADATION)]
            limits = {key.removeprefix(_DEGRADATION): parameters[key] for key in of_guard}
            degradation = Degradation.of({"fallback": settings["fallback"], **limits}, "degradation")
            self._law = trailer_law(name, trailer, combination, given, degradation)
        else:
            self._law = bare_law(name, trailer, combination, given)
        self._n_steered, self._n_units = len(trailer.steered_distances), len(vehicle.units)
        self._memory = self._law.init()
        first = to_ticks(parameters[_FIRST], _FIRST)
        self._control = Schedule(period=CONTROL.period, offset=first)
        self._demands = {f"steer_demand_{k}": 0.0 for k in range(1, self._n_steered + 1)}

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Demands [rad] at the end of a step; inputs hold during it."""
        estimate = estimate_of(tick, values)
        for now in range(tick, tick + ticks):
            if self._control.due(now):
                reading = reading_of(now, values, self._n_steered, self._n_units)
                self._memory, command = self._law.step(self._memory, now, estimate, reading)
                self._demands = {f"steer_demand_{k}": float(x) for k, x in enumerate(command.angles, start=1)}
        return self._demands

    def close(self) -> None:
        """Close the law."""
        close_part(self._law)


def _value(value: Any, folder: Path) -> Parameter:
    if isinstance(value, dict):
        return str(folder / value["file"])
    checked: Parameter = value
    return checked
