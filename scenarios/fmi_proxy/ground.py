"""The ground of a scenario as an FMU: poses of the units in, friction, slopes, heights and wind under them out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from scenarios.assembly.adapters import course_of, vehicle_of
from scenarios.assembly.ground import opened_ground
from scenarios.assembly.plants import plant_vehicle
from scenarios.courses import Course
from scenarios.fmi_export.variables import Quantity
from scenarios.fmi_import.ground_signals import GroundUnder, ground_signals
from scenarios.fmi_import.mapping import Signal
from scenarios.fmi_import.plant import pose_of_all
from scenarios.fmi_proxy.computation import Opening
from scenarios.fmi_proxy.description import Proxy, quantity
from scenarios.fmi_proxy.scenario_files import scenario_files, scenario_in
from scenarios.loop.control import CONTROL
from scenarios.options.driver import DriverOptions
from scenarios.options.scenario import Scenario
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.surface import Surface

_SEED: Final = "seed"
_AXES: Final = ("x", "y", "psi")


class LaidGround:
    """The ground of a scenario under its simulated vehicle."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        """Lay the surface along the course.

        Raises:
            ValueError: one line, if the scenario is not consistent.
        """
        nominal = vehicle_of(scenario)
        course: Course = course_of(scenario, nominal)
        self.surface, _ = opened_ground(scenario, course, seed)
        self.vehicle = in_wind_of(self.surface, plant_vehicle(scenario, nominal))
        self.under = GroundUnder(self.surface, self.vehicle)
        self.at_start = self.under.values(pose_of_all(self.vehicle, course.start))


def in_wind_of(surface: Surface, vehicle: Vehicle) -> Vehicle:
    """The vehicle with inputs for the wind where it blows."""
    return vehicle if surface.gust is None else vehicle.in_wind()


def ground_proxy(scenario: Scenario, seed: int) -> Proxy:
    """The ground of a scenario.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    ground = LaidGround(scenario, seed)
    units = range(1, len(ground.vehicle.units) + 1)
    plant = scenario.plant.model_copy(update={"fmu": None})
    changes = {"trailer_steering": "none", "steering": {}, "driver": DriverOptions(), "plant": plant,
               "off_tracking": "truth", "estimator": {}}  # fmt: skip
    return Proxy(
        kind="ground",
        name=f"{scenario.name}_ground",
        summary=f"ground of offtrack below a combination, on the course of {scenario.name}",
        inputs=[
            quantity(Signal(f"{axis}_{k}", "rad" if axis == "psi" else "m", f"of the frame of unit {k} in the world"))
            for axis in _AXES
            for k in units
        ],
        outputs=[quantity(one, ground.at_start[one.name]) for one in ground_signals(ground.vehicle)],
        parameters=[Quantity(_SEED, "-", "decides the roughness, a whole number", float(seed), 0.0, 2.0**53)],
        files=scenario_files(scenario, changes),
        notes=(
            "At the end of a step it gives the ground under the poses of the step's beginning. Communication steps are "
            "whole numbers of milliseconds. While all positions are 0 it is the ground at the start of the course: "
            "some importers begin so.",
        ),
        step=CONTROL.period * TICK / 2,
    )


class GroundComputation:
    """A ground in the process of its FMU."""

    def __init__(self, opening: Opening) -> None:
        """Lay the ground.

        Raises:
            ValueError: one line, if the scenario is not consistent.
        """
        self._ground = LaidGround(scenario_in(opening.folder), round(opening.parameters[_SEED]))
        self._values = self._ground.at_start

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Ground under the poses of the step's beginning."""
        units = range(1, len(self._ground.vehicle.units) + 1)
        poses = np.array([[values[f"{axis}_{k}"] for axis in _AXES] for k in units])
        if poses[:, :2].any():
            self._values = self._ground.under.values(poses)
        return self._values

    def text(self, name: str) -> str:
        """It has no text."""
        raise ValueError(f"there is no output {name}")

    def close(self) -> None:
        """Nothing to finish."""
