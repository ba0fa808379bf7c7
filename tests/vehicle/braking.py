"""Vehicles without systems of brakes and drive, for tests."""

from __future__ import annotations

from vehicle.combination.description import Vehicle


def without_governor(vehicle: Vehicle) -> Vehicle:
    """Whose wheels spin as fast as the engine's power turns them."""
    return vehicle.model_copy(update={"powertrain": None})
