"""Faults of a scenario by where they act: on sensors, in the loop of a trailer, or on brakes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from scenarios.loop_faults.applied import BrakeFaults, Numbered, TrailerFaults, brake_faults, trailer_faults
from scenarios.loop_faults.fault import BrakeShares, LoopFault
from scenarios.options.faults import FaultOptions
from sensors.faults.fault import Fault
from vehicle.combination.description import Vehicle

if TYPE_CHECKING:
    from scenarios.options.scenario import Scenario

# Kinds of plants with brakes and actuators of their own; others get the demands of the loop alone.
_BRAKED = ("multibody",)
_UNSTEERED = ("constant_slip",)


def sensor_faults(faults: Iterable[FaultOptions]) -> list[tuple[int, Fault]]:
    """Faults of sensors, each with its place among all."""
    return [(k, fault) for k, fault in enumerate(one.fault() for one in faults) if isinstance(fault, Fault)]


def loop_faults(faults: Iterable[FaultOptions]) -> list[tuple[int, LoopFault]]:
    """The other faults, each with its place among all."""
    return [(k, fault) for k, fault in enumerate(one.fault() for one in faults) if isinstance(fault, LoopFault)]


def refuse_loop_faults(faults: Iterable[FaultOptions], who: str) -> None:
    """Refuse faults of a trailer's loop.

    Raises:
        ValueError: one line, with ``who`` cannot have them.
    """
    for _, fault in loop_faults(faults):
        raise ValueError(f"faults: {fault.name} acts on the steering or the brakes of a run's trailer; {who} has none")


def with_failing_brakes(scenario: Scenario, vehicle: Vehicle, plant: str) -> Vehicle:
    """The simulated vehicle, with inputs for shares of brake torque if a fault of the scenario needs them.

    Raises:
        ValueError: one line, if vehicle or ``plant`` (its kind) cannot have that fault.
    """
    for _, fault in loop_faults(scenario.faults):
        if issubclass(fault.kind, BrakeShares):
            if plant not in _BRAKED:
                raise ValueError(f"faults: {fault.name} needs plant.kind = multibody; {plant} has brakes of its own")
            try:
                return vehicle.with_failing_brakes()
            except ValueError as error:
                raise ValueError(f"faults: {fault.name}: {error}") from None
    return vehicle


def opened_brake_faults(scenario: Scenario, vehicle: Vehicle, rng: Callable[[str], np.random.Generator]) -> BrakeFaults:
    """The scenario's faults of brakes, for the simulated vehicle.

    Raises:
        ValueError: one line, if it cannot have one of them.
    """
    return brake_faults(loop_faults(scenario.faults), vehicle, rng)


def opened_trailer_faults(
    scenario: Scenario, vehicle: Vehicle, unit: int, plant: str, rng: Callable[[str], np.random.Generator]
) -> TrailerFaults:
    """The scenario's faults in the loop of one trailer, a ``unit`` of the simulated vehicle.

    Raises:
        ValueError: one line, if neither it nor another trailer has steered axles, or it cannot have one of them.
    """
    faults: Numbered = [
        (k, fault) for k, fault in loop_faults(scenario.faults) if not issubclass(fault.kind, BrakeShares)
    ]
    steered = any(one.steered_axles for one in vehicle.units[1:])
    for _, fault in faults:
        if not steered or plant in _UNSTEERED:
            lacks = f"plant.kind = {plant} steers none" if steered else f"{vehicle.name} has no steered trailer axle"
            raise ValueError(f"faults: {fault.name} needs a steered trailer; {lacks}")
    return trailer_faults(faults, vehicle, unit, rng)
