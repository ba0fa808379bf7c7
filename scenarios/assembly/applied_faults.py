"""Faults of a scenario at work: on sensors, in the loop of each trailer, and in the brakes."""

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from scenarios.loop_faults.fault import (
    ActuatorFault,
    BrakeShares,
    Carried,
    LoopFault,
    LoopFaultContext,
    LoopFaultKind,
    MessageFault,
)
from scenarios.options.tables import FaultOptions
from sensors.faults.fault import Fault
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

if TYPE_CHECKING:
    from scenarios.options.scenario import Scenario


T = TypeVar("T")
Numbered = Sequence[tuple[int, LoopFault]]  # faults with their places among those of the scenario


class _Built(NamedTuple):
    """A fault, and the object of its kind."""

    fault: LoopFault
    kind: LoopFaultKind


class TrailerFaults:
    """Faults in the loop of one trailer; they act in the order in which they are given."""

    def __init__(self, faults: Sequence[_Built] = ()) -> None:
        self._faults = faults

    def carried(self, what: Carried, tick: int, sent: Sequence[T]) -> Sequence[T]:
        """Messages that arrive at this tick, oldest first; call it at every step."""
        for fault, kind in self._faults:
            if isinstance(kind, MessageFault) and kind.carries == what:
                sent = kind.carried(tick, sent, fault.active(tick))
        return sent

    def demanded(self, tick: int, demand: FloatArray, angles: FloatArray) -> FloatArray:
        """Demand (n_steered,) [rad] that makes sound actuators move as the faulty ones; call it at every step."""
        for fault, kind in self._faults:
            if isinstance(kind, ActuatorFault):
                demand = kind.demanded(tick, demand, angles, fault.active(tick))
        return demand


class BrakeFaults:
    """Faults of the vehicle's brakes."""

    def __init__(self, faults: Sequence[_Built] = ()) -> None:
        self._faults = faults

    def shares(self, tick: int) -> tuple[float, ...]:
        """Share of its torque that the brake of each wheel has [-]; empty without faults."""
        shares = [
            kind.shares(tick, fault.active(tick)) for fault, kind in self._faults if isinstance(kind, BrakeShares)
        ]
        return tuple(reduce(np.multiply, shares).tolist()) if shares else ()


def trailer_faults(
    faults: Numbered, vehicle: Vehicle, unit: int, rng: Callable[[str], np.random.Generator]
) -> TrailerFaults:
    """Faults in the loop of one trailer, a ``unit`` of the simulated vehicle; a trailer without steered axles has none.

    Raises:
        ValueError: one line, if the trailer cannot have one of them.
    """
    if not vehicle.led_unit(unit).steered_axles:
        return TrailerFaults()
    return TrailerFaults(
        [
            _Built(fault, fault.built(LoopFaultContext(vehicle=vehicle, unit=unit, rng=rng(f"fault {k}"))))
            for k, fault in faults
            if not issubclass(fault.kind, BrakeShares)
        ]
    )


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


def with_failing_brakes(scenario: "Scenario", vehicle: Vehicle, plant: str) -> Vehicle:
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


def opened_brake_faults(
    scenario: "Scenario", vehicle: Vehicle, rng: Callable[[str], np.random.Generator]
) -> BrakeFaults:
    """The scenario's faults of brakes, for the simulated vehicle.

    Raises:
        ValueError: one line, if it cannot have one of them.
    """
    last = len(vehicle.units) - 1
    return BrakeFaults(
        [
            _Built(fault, fault.built(LoopFaultContext(vehicle=vehicle, unit=last, rng=rng(f"fault {k}"))))
            for k, fault in loop_faults(scenario.faults)
            if issubclass(fault.kind, BrakeShares)
        ]
    )


def opened_trailer_faults(
    scenario: "Scenario", vehicle: Vehicle, unit: int, plant: str, rng: Callable[[str], np.random.Generator]
) -> TrailerFaults:
    """The scenario's faults in the loop of one trailer, a ``unit`` of the simulated vehicle.

    Raises:
        ValueError: one line, if neither it nor another trailer has steered axles, or it cannot have one of them.
    """
    faults: Numbered = [
        (k, fault) for k, fault in loop_faults(scenario.faults) if not issubclass(fault.kind, BrakeShares)
    ]
    steered = vehicle.n_by_law > 0
    for _, fault in faults:
        if not steered or plant in _UNSTEERED:
            lacks = f"plant.kind = {plant} steers none" if steered else f"{vehicle.name} has no steered trailer axle"
            raise ValueError(f"faults: {fault.name} needs a steered trailer; {lacks}")
    return trailer_faults(faults, vehicle, unit, rng)
