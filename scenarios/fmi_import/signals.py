"""Signals of the parts that an FMU can be."""

from __future__ import annotations

from scenarios.fmi_import.driver import driver_signals
from scenarios.fmi_import.law import law_signals
from scenarios.fmi_import.mapping import PartSignals
from scenarios.fmi_import.off_tracking import off_tracking_signals
from scenarios.fmi_import.plant import plant_signals
from vehicle.combination.description import Vehicle


def signals_of(part: str, vehicle: Vehicle) -> PartSignals:
    """Signals of a trailer steering law, a source of off-tracking, a driver or a plant for a vehicle.

    Raises:
        ValueError: one line, for a law where no trailer axle is steered.
    """
    if part == "driver":
        return driver_signals(len(vehicle.units))
    if part == "off_tracking":
        return off_tracking_signals(vehicle)
    if part == "plant":
        return plant_signals(vehicle)
    steered = [len(unit.steered_axles) for unit in vehicle.units[1:] if unit.steered_axles]
    if not steered:
        raise ValueError(f"vehicle {vehicle.name}: no axle of a trailer is steered; choose another --vehicle")
    return law_signals(steered[-1], len(vehicle.units))
