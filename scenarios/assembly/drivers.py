"""Drivers of the tractor: along the course, or from a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from controllers.checked import CheckedDriver
from controllers.driver import DriverLike, PreviewDriver
from controllers.driver_trace import DriverTrace, TraceDriver
from controllers.reversing.chain import RollingChain
from controllers.shunting import ShuntingDriver, Stop
from controllers.tractor import TractorGeometry
from scenarios.assembly.adapters import tractor_geometry
from scenarios.assembly.recorded_drive import read_trace
from scenarios.catalogue import DRIVER, Part, check_made, constructed, resolve
from scenarios.courses import Course
from scenarios.options.driver import DriverOptions
from scenarios.options.scenario import Scenario
from vehicle.combination.description import Vehicle
from vehicle.option import Parameter


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriverContext:
    """Context from which a driver is constructed."""

    vehicle: Vehicle  # nominal: ``plant.…`` changes only the simulated one
    tractor: TractorGeometry
    course: Course
    speed: float  # set speed [m/s]
    options: DriverOptions
    parameters: Mapping[str, Parameter]  # ``driver.parameters.…`` of the user's own driver


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedDriver:
    """A driver with the planned duration and start speed."""

    driver: DriverLike[Any]
    duration: float  # planned duration of the drive [s]
    start_speed: float  # [m/s]
    trace: DriverTrace | None = None  # the recorded drive that is repeated; it is not bound to the course


class OnCourse:
    """Follows the course at set speed or below a lateral limit; stops and reverses as in ``driver.stops``."""

    @classmethod
    def of(cls, context: DriverContext) -> OpenedDriver:
        """Driver on the course."""
        options = context.options
        if options.trace is not None:
            raise ValueError("driver.trace needs driver.kind = recorded")
        limit = math.inf if options.max_lateral_acceleration is None else options.max_lateral_acceleration
        driver = PreviewDriver(context.tractor, context.course.path, context.speed, max_lateral_acceleration=limit)
        if not options.stops:
            return OpenedDriver(driver=driver, duration=driver.duration, start_speed=context.speed)
        stops = [Stop(stop.station, stop.wait, stop.back) for stop in options.stops]
        try:
            shunting = ShuntingDriver(driver, RollingChain.of(context.vehicle), stops)
        except ValueError as error:
            raise ValueError(f"driver.{error}") from error
        return OpenedDriver(driver=shunting, duration=shunting.duration, start_speed=context.speed)


class AsRecorded:
    """Repeats the steer angles and speeds of the CSV file ``driver.trace``; does not follow the course."""

    @classmethod
    def of(cls, context: DriverContext) -> OpenedDriver:
        """Driver from a recording."""
        options = context.options
        if options.trace is None:
            raise ValueError("driver.kind = recorded: driver.trace is missing, a CSV file")
        if options.stops:
            raise ValueError(
                "driver.stops and driver.trace: give only one of them; a recorded drive contains its stops"
            )
        trace = read_trace(Path(options.trace))
        driver = TraceDriver(trace)
        start_speed = context.speed if driver.start_speed is None else driver.start_speed
        return OpenedDriver(driver=driver, duration=driver.duration, start_speed=start_speed, trace=trace)


def opened_driver(scenario: Scenario, vehicle: Vehicle, course: Course) -> OpenedDriver:
    """Open the scenario's driver; a driver without a planned duration is expected to keep the set speed.

    Raises:
        ValueError: one line, if there is no such driver or the context does not fit.
    """
    options = scenario.driver
    kind = options.kind or ("preview" if options.trace is None else "recorded")
    part: Part[DriverContext, OpenedDriver | DriverLike[Any]] = resolve("driver.kind", kind, DRIVER)
    context = DriverContext(
        vehicle=vehicle,
        tractor=tractor_geometry(vehicle, course),
        course=course,
        speed=scenario.speed,
        options=options,
        parameters=options.parameters,
    )
    driver = constructed("driver.kind", kind, lambda: part.of(context))
    if not isinstance(driver, OpenedDriver):
        driver = OpenedDriver(driver=driver, duration=course.length / scenario.speed, start_speed=scenario.speed)
    check_made("driver.kind", kind, driver.driver, ("init", "step"))
    if not 0.0 < driver.duration < math.inf:  # a run that gets stuck would never end
        raise ValueError(f"driver.kind = {kind}: duration = {driver.duration} s must be positive and finite")
    return replace(driver, driver=CheckedDriver(driver.driver, f"driver.kind = {kind}"))
