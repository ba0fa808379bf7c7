"""Construct the tractor's driver and the trailers' guarded steering laws by name."""

import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from controllers.checked import CheckedDriver
from controllers.driver import DriverLike, DriverTrace, PreviewDriver, ShuntingDriver, Stop, TraceDriver
from controllers.reversing_law import RollingChain
from controllers.tractor import TractorGeometry
from controllers.trailer import Combination, TrailerGeometry, TrailerSteering
from controllers.trailer_steering.lqr import AllSpeeds
from controllers.trailer_steering.policy import shipped_networks
from controllers.trailer_steering.safeguarded import Degradation, Safeguarded
from scenarios.assembly.adapters import tractor_guided_at
from scenarios.catalogue import DRIVER, TRAILER_STEERING, Part, check_made, constructed, resolve
from scenarios.courses import Course
from scenarios.options.scenario import Scenario
from scenarios.options.tables import DriverOptions
from vehicle.combination.description import Vehicle
from vehicle.foundation.data_file import Column, open_table
from vehicle.foundation.user_file import nearest
from vehicle.frames import FloatArray
from vehicle.option import COMBINATION, Parameter, arguments

_COLUMNS: Final = {  # with the factor to SI; the limits are beyond any lorry, wrong units exceed them
    "time_s": (Column("time_s", 86_400.0, "s"), 1.0),
    "steer_deg": (Column("steer_deg", 90.0, "deg"), math.pi / 180.0),
    "speed_kmh": (Column("speed_kmh", 200.0, "km/h"), 1.0 / 3.6),
    "acceleration": (Column("acceleration", 20.0, "m/s2"), 1.0),
}


def read_trace(path: Path) -> DriverTrace:
    """Read a drive; the first line names the columns time_s, steer_deg, and speed_kmh or acceleration [m/s2].

    Raises:
        ValueError: one line naming file, column, line and limit.
    """
    try:
        table = open_table(path)
    except ValueError as error:
        raise ValueError(f"driver.trace: {error}") from error
    _check(path, table.names)
    numbers = table.numbers([_COLUMNS[name][0] for name in table.names])
    columns: dict[str, FloatArray] = {
        name: _COLUMNS[name][1] * values for name, values in zip(table.names, numbers.T, strict=True)
    }
    try:
        return DriverTrace(
            time=columns["time_s"],
            steer=columns["steer_deg"],
            speed=columns.get("speed_kmh"),
            acceleration=columns.get("acceleration"),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _check(path: Path, names: list[str]) -> None:
    for name in names:
        if name not in _COLUMNS:
            raise ValueError(f"{path}: unknown column '{name}'{nearest(name, _COLUMNS)}")
    for name in ("time_s", "steer_deg"):
        if name not in names:
            raise ValueError(f"{path}: column '{name}' is missing")
    if not {"speed_kmh", "acceleration"} & set(names):
        raise ValueError(f"{path}: a column 'speed_kmh' or 'acceleration' is missing")


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
        tractor=tractor_guided_at(vehicle, course.reference),
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


def law_uses_off_tracking(name: str) -> bool:
    """True if a law uses the estimated off-tracking, which is the default of its class."""
    return bool(getattr(resolve("trailer_steering", name, TRAILER_STEERING), "uses_off_tracking", True))


def steering_parameters(scenario: Scenario) -> dict[str, Parameter]:
    """Parameters of a scenario's law.

    Raises:
        ValueError: one line, if the file of a policy is missing.
    """
    parameters = dict(scenario.steering)
    if scenario.trailer_steering == "policy":
        if scenario.policy.path is None:
            raise ValueError(
                "trailer_steering = policy: policy.path is missing: the file of the network, or the name of a shipped "
                f"one: --set policy.path={shipped_networks()[0]}"
            )
        parameters["path"] = scenario.policy.path
    return parameters


def trailer_law(
    name: str,
    trailer: TrailerGeometry,
    combination: Combination,
    parameters: Mapping[str, Parameter],
    degradation: Degradation | None = None,
) -> Safeguarded:
    """Construct a trailer's law, with all safeguards, by its name in the catalogue or as ``package.module:Name``.

    It is guarded against bad estimates, by default as `Degradation` says, unless its class has
    ``uses_off_tracking = False``. Above the ``speeds`` that it is for, the LQR steers.

    Raises:
        ValueError: one line, if there is no such law, a parameter is unknown or outside its limits, or the law cannot
            be constructed.
    """
    law = _constructed_law(name, trailer, combination, parameters)
    law = _for_all_speeds(law, trailer, combination)
    guard = (degradation or Degradation()) if law_uses_off_tracking(name) else None
    return Safeguarded(law, f"trailer_steering = {name}", trailer, combination, guard)


def bare_law(
    name: str, trailer: TrailerGeometry, combination: Combination, parameters: Mapping[str, Parameter]
) -> Safeguarded:
    """The same without any safeguard but the check of its output.

    Raises:
        ValueError: one line, as `trailer_law`.
    """
    law = _constructed_law(name, trailer, combination, parameters)
    return Safeguarded(law, f"trailer_steering = {name}", trailer, combination, checks_only=True)


def _for_all_speeds(
    law: TrailerSteering[Any], trailer: TrailerGeometry, combination: Combination
) -> TrailerSteering[Any]:
    """The law, with the one above if it is not for all speeds."""
    speeds, above = getattr(law, "speeds", None), getattr(law, "above", None)
    if speeds is None or not trailer.steered_distances:
        return law
    other = None if above is None else _for_all_speeds(above, trailer, combination)
    return AllSpeeds(law, speeds, trailer, combination, other)


def _constructed_law(
    name: str, trailer: TrailerGeometry, combination: Combination, parameters: Mapping[str, Parameter]
) -> TrailerSteering[Any]:
    part = resolve("trailer_steering", name, TRAILER_STEERING)
    given = arguments(part, parameters, "steering")
    if COMBINATION in inspect.signature(part).parameters:
        given[COMBINATION] = combination
    try:
        law: TrailerSteering[Any] = constructed("trailer_steering", name, lambda: part(trailer, **given))
    except TypeError as error:
        shape = f"{part.__name__}(trailer, ...)"
        raise ValueError(f"trailer_steering = {name}: cannot be constructed as {shape}: {error}") from error
    return law
