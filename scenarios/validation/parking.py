"""Checks that vehicles stay where they are parked, and that they come to rest after a stop."""

from __future__ import annotations

from typing import Final

import numpy as np

from scenarios.validation.check import Check, Section
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle, load_vehicle, vehicle_names
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

_SLOPE: Final = 0.1  # [-]
_FRICTION: Final = 0.8  # dry road
_BRAKES: Final = -3.0  # demanded: three times what the slope needs [m/s2]
_SETTLING: Final = 5.0  # time in which tyres and bodies take up the slope [s]
_PARKED: Final = 600.0  # [s]
_STANDS: Final = {"on cross-fall": (0.0, _SLOPE), "up-hill": (_SLOPE, 0.0), "down-hill": (-_SLOPE, 0.0)}


def parking(quick: bool) -> Section:
    """Creep of parked vehicles in ten minutes, and the rest after braking to a stop on a hill."""
    names = ("rigid_truck",) if quick else vehicle_names()
    return Section(
        title="Parking",
        text=f"Brakes on, slope of {100 * _SLOPE:g} %, friction {_FRICTION:g}. Tyres deflect within "
        f"{_SETTLING:g} s; from then on nothing may move for ten minutes, for only rolling and sliding relax a tyre.",
        checks=(
            *(
                Check(
                    f"{name} {where}: way in ten minutes",
                    1e3 * creep(load_vehicle(name), grade, cross_fall),
                    "mm",
                    target=0.0,
                    tolerance=1.0,
                    source="a parked vehicle stays",
                )
                for name in names
                for where, (grade, cross_fall) in _STANDS.items()
            ),
            _stop(load_vehicle(names[0])),
        ),
    )


def creep(vehicle: Vehicle, grade: float, cross_fall: float, duration: float = _PARKED) -> float:
    """Largest distance [m] that a unit of the parked vehicle moves in ``duration`` [s], after settling."""
    plant = Plant(vehicle, Surface(friction=_FRICTION, grade=grade, cross_fall=cross_fall))
    start = plant.initial_state(Pose2(0.0, 0.0, 0.0), 0.0)
    return _moved(plant, plant.step(start, _braking(vehicle), round(_SETTLING / TICK)), vehicle, duration)


def _stop(vehicle: Vehicle) -> Check:
    """Braked from 8 m/s to a stop on the hill: the tyres rock, and then nothing is left that pulls or creeps."""
    plant = Plant(vehicle, Surface(friction=_FRICTION, grade=_SLOPE))
    moving = plant.initial_state(Pose2(0.0, 0.0, 0.0), 8.0)
    stopped = plant.step(moving, _braking(vehicle), round((2.0 * _SETTLING) / TICK))
    return Check(
        f"{vehicle.name} braked to a stop up-hill: way in the ten minutes after that",
        1e3 * _moved(plant, stopped, vehicle, _PARKED),
        "mm",
        target=0.0,
        tolerance=1.0,
        source="brakes hold, and no tyre is wound up after a stop",
    )


def _moved(plant: Plant, state: FloatArray, vehicle: Vehicle, duration: float) -> float:
    later = plant.step(state, _braking(vehicle), round(duration / TICK))
    way = plant.observe(later, 0).poses - plant.observe(state, 0).poses
    return float(np.hypot(*way[:, :2].T).max())


def _braking(vehicle: Vehicle) -> VehicleCommand:
    return VehicleCommand(0.0, _BRAKES, (0.0,) * sum(len(unit.steered_axles) for unit in vehicle.units[1:]))
