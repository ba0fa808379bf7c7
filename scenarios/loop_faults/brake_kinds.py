"""Fault kinds of the brakes: they act in the simulated vehicle, and its brake system does not know of them."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from scenarios.loop_faults.fault import BrakeShares, LoopFaultContext
from vehicle.combination.layout import wheels
from vehicle.frames import FloatArray
from vehicle.option import Option


class BrakeFault(BrakeShares):
    """Brakes of a unit, of one of its axles or of one side have a share of their torque; the retarder stays sound."""

    options: ClassVar[tuple[Option, ...]] = (
        Option("share", 0.0, "torque over that of sound brakes", low=0.0, high=1.0),
        Option("unit", 0, "1 the tractor, 2 the first trailer, ...; 0: the last", low=0, high=20),
        Option("axle", 0, "of that unit from the front; 0: all", low=0, high=20),
        Option("side", 0, "1 left, -1 right, 0 both", low=-1, high=1),
    )

    def __init__(self, amount: tuple[float, ...], context: LoopFaultContext) -> None:
        super().__init__(amount, context)
        share, side, units = amount[0], int(amount[3]), context.vehicle.units
        unit, axle = int(amount[1]) or len(units), int(amount[2])
        if unit > len(units):
            raise ValueError(f"unit = {unit}: {context.vehicle.name} has {len(units)} units")
        named = units[unit - 1]
        if axle > len(named.axles):
            raise ValueError(f"axle = {axle}: {named.name} has {len(named.axles)} axles")
        chosen = [
            wheel.unit == unit - 1 and axle in (0, wheel.axle_in_unit + 1) and side in (0, wheel.side)
            for wheel in wheels(context.vehicle)
        ]
        braked = [wheel.brake is not None for wheel in wheels(context.vehicle)]
        if not any(there and brake for there, brake in zip(chosen, braked, strict=True)):
            raise ValueError(f"no brake there: {named.name} has none on the axles that the fault names")
        self._shares: FloatArray = np.where(chosen, share, 1.0)

    def shares(self, tick: int, active: bool) -> FloatArray:
        """Shares of all wheels."""
        return self._shares if active else np.ones_like(self._shares)
