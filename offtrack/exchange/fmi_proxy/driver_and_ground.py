"""Driver and ground of a scenario as FMUs: motion and poses in; demands, friction, heights and wind out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from controllers.driver import PERIOD as CONTROL_PERIOD
from controllers.driver import DriverCommand
from offtrack.exchange.fmi_export.variables import Quantity
from offtrack.exchange.fmi_import.fmu_plant import pose_of_all
from offtrack.exchange.fmi_import.mapping import Signal
from offtrack.exchange.fmi_import.numbered_signals import MOTION, GroundUnder, articulation_signals, ground_signals
from offtrack.exchange.fmi_proxy.proxy import (
    Computation,
    Opening,
    Proxy,
    moments,
    quantity,
    scenario_files,
    scenario_in,
)
from scenarios.assembly.adapters import course_of, plant_kind, plant_vehicle, vehicle_of
from scenarios.assembly.drivers_and_laws import opened_driver
from scenarios.assembly.trailer_run import opened_ground
from scenarios.courses import Course
from scenarios.loop.channel import CONTROL
from scenarios.options.scenario import Scenario
from scenarios.options.vehicle_and_driver import DriverOptions
from sensors.messages import EgoState
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.foundation.own_parts import close_part
from vehicle.surface import Surface


def driver_proxy(scenario: Scenario) -> Proxy:
    """The driver of a scenario on its course.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    kind = scenario.driver.kind or ""
    if kind.endswith(".fmu"):
        raise ValueError(f"driver = {kind}: is an FMU already")
    if plant_kind(scenario) == "constant_slip":
        raise ValueError(f"scenario {scenario.name}: nobody drives, its motion is prescribed")
    vehicle = vehicle_of(scenario)
    opened = opened_driver(scenario, vehicle, course_of(scenario, vehicle))
    close_part(opened.driver)
    changes = {"trailer_steering": "none", "steering": {}, "off_tracking": "truth", "estimator": {}}
    return Proxy(
        kind="driver",
        name=f"{scenario.name}_driver",
        summary=f"driver of offtrack on the course of {scenario.name}",
        inputs=[quantity(signal) for signal in (*MOTION, *articulation_signals(len(vehicle.units)))],
        outputs=[
            Quantity("steer", "rad", "road-wheel angle of the tractor's foremost steered axle, + left"),
            Quantity("acceleration", "m/s2", "above 0 drives, below 0 brakes"),
            Quantity("gear", "-", "1 forward, -1 backward", 1.0),
        ],
        files=scenario_files(scenario, changes),
        notes=(
            f"The driver acts every {1e3 * CONTROL_PERIOD:g} ms; the demands are there at the end of the step in which "
            "that is. Communication steps are whole numbers of milliseconds. In a first step with all "
            "inputs 0 nothing is done: some importers begin so.",
        ),
        step=CONTROL_PERIOD,
        stop=opened.duration,
    )


class DriverComputation(Computation):
    """A driver in the process of its FMU."""

    def __init__(self, opening: Opening) -> None:
        """Open the driver.

        Raises:
            ValueError: one line, if the scenario is not consistent.
        """
        scenario = scenario_in(opening.folder)
        vehicle = vehicle_of(scenario)
        self._driver = opened_driver(scenario, vehicle, course_of(scenario, vehicle)).driver
        self._memory = self._driver.init()
        self._demand = DriverCommand(steer=0.0, acceleration=0.0)

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Demands at the end of a step; inputs hold during it."""
        is_there = tick > 0 or any(values.values())
        motion = {signal.name: values[signal.name] for signal in MOTION}
        articulation = tuple(value for name, value in values.items() if name.startswith("articulation_"))
        for now in moments(tick, ticks, CONTROL.period) if is_there else ():
            ego = EgoState(tick=now, articulation=articulation, **motion)
            self._memory, self._demand = self._driver.step(self._memory, now, ego)
        return {name: float(value) for name, value in self._demand._asdict().items()}

    def close(self) -> None:
        """Close the driver."""
        close_part(self._driver)


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
        self.vehicle = in_wind_of(self.surface, plant_vehicle(scenario))
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


class GroundComputation(Computation):
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
