"""Faults of the loop at work: in the loop of each trailer, and in the brakes of the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import NamedTuple, TypeVar

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
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

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
    if not vehicle.units[unit].steered_axles:
        return TrailerFaults()
    return TrailerFaults(
        [
            _Built(fault, fault.built(LoopFaultContext(vehicle=vehicle, unit=unit, rng=rng(f"fault {k}"))))
            for k, fault in faults
            if not issubclass(fault.kind, BrakeShares)
        ]
    )


def brake_faults(faults: Numbered, vehicle: Vehicle, rng: Callable[[str], np.random.Generator]) -> BrakeFaults:
    """Faults of the brakes of the simulated vehicle.

    Raises:
        ValueError: one line, if it cannot have one of them.
    """
    last = len(vehicle.units) - 1
    return BrakeFaults(
        [
            _Built(fault, fault.built(LoopFaultContext(vehicle=vehicle, unit=last, rng=rng(f"fault {k}"))))
            for k, fault in faults
            if issubclass(fault.kind, BrakeShares)
        ]
    )
