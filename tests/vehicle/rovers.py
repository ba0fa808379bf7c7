"""Rovers that are driven, for tests."""

import math

from vehicle.frames import Pose2
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import Rover, load_rover, load_soil
from vehicle.rover.plant import RoverPlant
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

GRAVITY = 9.81
HOME = Pose2(0.0, 0.0, 0.0)
STRAIGHT = (0.0, 0.0, 0.0, 0.0)
STILL = RoverCommand(STRAIGHT, STRAIGHT)


def slope_towards(direction: float, steepness: float) -> tuple[float, float]:
    """``slope_x, slope_y`` of a plane that rises by an angle ``steepness`` [rad] towards ``direction`` [rad] in W."""
    rise = math.tan(steepness)
    return rise * math.cos(direction), rise * math.sin(direction)


def plant_on(soil: str | None, terrain: Terrain | None = None, rover: Rover | None = None) -> RoverPlant:
    """A rover, by default El Dorado II; interpreted, to save the time of a compiler."""
    ground = Terrain() if terrain is None else terrain
    vehicle = load_rover("el_dorado_ii") if rover is None else rover
    return RoverPlant(vehicle, ground, None if soil is None else load_soil(soil), "interpreted")


def driven(plant: RoverPlant, command: RoverCommand, seconds: float, pose: Pose2 = HOME) -> RoverTruth:
    """Truth after a command was held for some time from a standstill."""
    ticks = round(1000.0 * seconds)
    return plant.observe(plant.step(plant.initial_state(pose), command, ticks), ticks)
