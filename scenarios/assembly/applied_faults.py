"""Faults of a scenario at work: on sensors, in the loop of each trailer, and in the brakes."""

from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from typing import TypeVar

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
from scenarios.options.scenario import Scenario
from scenarios.options.tables import FaultOptions
from sensors.faults.fault import Fault
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

T = TypeVar("T")
Built = tuple[LoopFault, LoopFaultKind]  # a fault, and the object of its kind
Streams = Callable[[str], np.random.Generator]  # random stream by name


class LoopFaults:
    """Faults in the loop of one trailer, or of the vehicle's brakes; they act in the order in which they are given."""

    def __init__(self, faults: Sequence[Built] = ()) -> None:
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

    def shares(self, tick: int) -> tuple[float, ...]:
        """Share of its torque that the brake of each wheel has [-]; empty without faults."""
        shares = [
            kind.shares(tick, fault.active(tick)) for fault, kind in self._faults if isinstance(kind, BrakeShares)
        ]
        return tuple(reduce(np.multiply, shares).tolist()) if shares else ()


def sensor_faults(faults: Iterable[FaultOptions]) -> list[tuple[int, Fault]]:
    """Faults of sensors, each with its place among all."""
    return [(k, fault) for k, fault in enumerate(one.fault() for one in faults) if isinstance(fault, Fault)]


def loop_faults(faults: Iterable[FaultOptions], *, of_brakes: bool) -> list[tuple[int, LoopFault]]:
    """Faults of the brakes or of the rest of the loop, each with its place among all."""
    made = enumerate(one.fault() for one in faults)
    return [
        (k, fault)
        for k, fault in made
        if isinstance(fault, LoopFault) and issubclass(fault.kind, BrakeShares) == of_brakes
    ]


def refuse_loop_faults(faults: Iterable[FaultOptions], who: str) -> None:
    """Refuse faults of a trailer's loop.

    Raises:
        ValueError: one line, with ``who`` cannot have them.
    """
    for one in faults:
        fault = one.fault()
        if isinstance(fault, LoopFault):
            acts = "acts on the steering or the brakes of a run's trailer"
            raise ValueError(f"faults: {fault.name} {acts}; {who} has none")


def with_failing_brakes(scenario: Scenario, vehicle: Vehicle, plant: str) -> Vehicle:
    """The simulated vehicle, with inputs for shares of brake torque if a fault of the scenario needs them.

    Raises:
        ValueError: one line, if vehicle or ``plant`` (its kind) cannot have that fault.
    """
    for _, fault in loop_faults(scenario.faults, of_brakes=True):
        if plant != "multibody":
            raise ValueError(f"faults: {fault.name} needs plant.kind = multibody; {plant} has brakes of its own")
        try:
            return vehicle.with_failing_brakes()
        except ValueError as error:
            raise ValueError(f"faults: {fault.name}: {error}") from None
    return vehicle


def opened_brake_faults(scenario: Scenario, vehicle: Vehicle, rng: Streams) -> LoopFaults:
    """The scenario's faults of brakes, for the simulated vehicle.

    Raises:
        ValueError: one line, if it cannot have one of them.
    """
    return LoopFaults(_built(loop_faults(scenario.faults, of_brakes=True), vehicle, len(vehicle.units) - 1, rng))


def opened_trailer_faults(scenario: Scenario, vehicle: Vehicle, unit: int, plant: str, rng: Streams) -> LoopFaults:
    """The scenario's faults in the loop of one trailer, a ``unit`` of the simulated vehicle.

    A trailer without steered axles has none.

    Raises:
        ValueError: one line, if neither it nor another trailer has steered axles, or it cannot have one of them.
    """
    faults = loop_faults(scenario.faults, of_brakes=False)
    steered = vehicle.n_by_law > 0
    for _, fault in faults:
        if not steered or plant == "constant_slip":
            lacks = f"plant.kind = {plant} steers none" if steered else f"{vehicle.name} has no steered trailer axle"
            raise ValueError(f"faults: {fault.name} needs a steered trailer; {lacks}")
    return LoopFaults(_built(faults, vehicle, unit, rng) if vehicle.led_unit(unit).steered_axles else ())


def _built(faults: Iterable[tuple[int, LoopFault]], vehicle: Vehicle, unit: int, rng: Streams) -> list[Built]:
    """The faults with the objects of their kinds, each with a random stream of its own."""
    return [
        (fault, fault.built(LoopFaultContext(vehicle=vehicle, unit=unit, rng=rng(f"fault {k}")))) for k, fault in faults
    ]
