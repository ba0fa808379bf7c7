"""From the name of a vehicle or rover to its model."""

from __future__ import annotations

from scenarios.fmi_export.combination import combination_model
from scenarios.fmi_export.model import PlantModel
from scenarios.fmi_export.rover import rover_model
from scenarios.vehicle_sheet.library import is_rover
from vehicle.combination.description import load_vehicle
from vehicle.rover.description import load_rover
from vehicle.rover.soil import load_soil


def plant_model(name_or_path: str, soil: str | None, *, wind: bool) -> PlantModel:
    """The model of a shipped vehicle or rover, or of one from a TOML file.

    Raises:
        ValueError: one line, if the file is wrong, or an option is not for its kind.
    """
    if is_rover(name_or_path):
        if wind:
            raise ValueError(f"--wind: rover {name_or_path} has no inputs for the wind")
        return rover_model(load_rover(name_or_path), None if soil is None else load_soil(soil))
    if soil is not None:
        raise ValueError(f"--soil {soil}: {name_or_path} is no rover; trucks drive on roads")
    vehicle = load_vehicle(name_or_path)
    return combination_model(vehicle.in_wind() if wind else vehicle)
