"""Plants: the simulated vehicle, which may differ from the data sheet of the controllers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from scenarios.assembly.adapters import described_vehicle
from scenarios.catalogue import PLANT, Part, check_made, constructed, resolve
from scenarios.options.course import ConstantSlipOptions
from scenarios.options.scenario import Scenario
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import ConstantSlipPlant, Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.combination.variants import changed_vehicle
from vehicle.foundation.plant_like import PlantLike
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlantContext:
    """Context from which a plant is constructed."""

    vehicle: Vehicle  # with the changes of ``plant.…``
    surface: Surface
    scenario: Scenario


class CombinationPlant(PlantLike[Truth, VehicleCommand], Protocol):
    """A plant of a combination."""

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State at a pose of the tractor, rolling straight at a speed [m/s]."""


class Multibody:
    """A chain of rigid bodies on slipping tyres; each body is sprung in heave, pitch and roll."""

    @classmethod
    def of(cls, context: PlantContext) -> CombinationPlant:
        """Plant of the vehicle on its surface."""
        return Plant(context.vehicle, context.surface)


class ConstantSlip:
    """Prescribed motion: the last trailer is dragged straight at the slip angle of a course ``constant-slip``."""

    @classmethod
    def of(cls, context: PlantContext) -> CombinationPlant:
        """Plant without dynamics."""
        scenario, course = context.scenario, context.scenario.course
        if not isinstance(course, ConstantSlipOptions):
            raise ValueError("plant.kind = constant_slip needs course.kind = constant-slip")
        if scenario.trailer_steering != "none":
            raise ValueError(
                f"trailer_steering = {scenario.trailer_steering}: the trailer of {scenario.name} is dragged at a "
                "constant slip angle and cannot be steered; use trailer_steering=none"
            )
        slip_angle, last = math.radians(course.slip_angle_deg), len(context.vehicle.units) - 1
        return ConstantSlipPlant(
            context.vehicle, context.surface, unit=last, slip_angle=slip_angle, speed=scenario.speed
        )


def plant_vehicle(scenario: Scenario) -> Vehicle:
    """The simulated vehicle: the scenario's with the changes of ``plant.…`` and ``brakes.…``.

    Raises:
        ValueError: one line, for a change that does not fit.
    """
    vehicle, changes = described_vehicle(scenario), scenario.plant.changes()
    changed = _with_systems(scenario, changed_vehicle(vehicle, changes) if changes else vehicle)
    for nominal, unit in zip(vehicle.units, changed.units, strict=True):
        if len(nominal.steered_axles) != len(unit.steered_axles):
            raise ValueError(f"plant.*: unit '{unit.name}' would have another number of steered axles")
    return changed.led()


def _with_systems(scenario: Scenario, vehicle: Vehicle) -> Vehicle:
    """The vehicle with the systems of ``brakes.…`` on or off; one without their data has none of them."""
    options = scenario.brakes
    vehicle = _switched(vehicle, "brakes", "abs", options.abs)
    return _switched(vehicle, "powertrain", "traction_control", options.traction_control)


def _switched(vehicle: Vehicle, table: str, system: str, on: bool | None) -> Vehicle:
    data = getattr(vehicle, table)
    if on and data is None:
        raise ValueError(f"brakes.{system} = true: the file of vehicle {vehicle.name} has no table [{table}]")
    if on is None or data is None:
        return vehicle
    return vehicle.model_copy(update={table: data.model_copy(update={system: on})})


def plant_kind(scenario: Scenario) -> str:
    """Name of the scenario's plant; by default as the course needs."""
    prescribed = isinstance(scenario.course, ConstantSlipOptions)
    if scenario.plant.fmu and scenario.plant.kind:
        raise ValueError("plant.kind and plant.fmu: give only one of them")
    return scenario.plant.fmu or scenario.plant.kind or ("constant_slip" if prescribed else "multibody")


def opened_plant(scenario: Scenario, vehicle: Vehicle, surface: Surface) -> CombinationPlant:
    """Open the scenario's plant for the simulated vehicle.

    Raises:
        ValueError: one line, if there is no such plant or it does not fit.
    """
    key, kind = "plant.fmu" if scenario.plant.fmu else "plant.kind", plant_kind(scenario)
    part: Part[PlantContext, CombinationPlant] = resolve(key, kind, PLANT)
    context = PlantContext(vehicle=vehicle, surface=surface, scenario=scenario)
    plant = constructed(key, kind, lambda: part.of(context))
    check_made(key, kind, plant, ("initial_state", "step", "observe"))
    return plant
