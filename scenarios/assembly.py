"""From a scenario to the parts of its run: everything is constructed, and refused if need be, before anything moves."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from typing import Any, Protocol

from controllers.driver import PreviewDriver
from controllers.trailer import TrailerGeometry, TrailerSteering
from scenarios.adapters import course_of, surface_of, tractor_geometry, trailer_geometry, watched_unit
from scenarios.cameras import Cameras
from scenarios.catalogue import TRAILER_STEERING, resolve
from scenarios.courses import Course
from scenarios.options.course import ConstantSlipOptions
from scenarios.options.rig import RigOptions
from scenarios.randomness import stream
from scenarios.scenario import Parameter, Scenario
from scenarios.sensing import OffTrackingSource, PoseSensor, opened_sensing
from vehicle.clock import TICK, Schedule
from vehicle.description import Vehicle, load_vehicle
from vehicle.frames import FloatArray, Pose2
from vehicle.parameter_file import nearest
from vehicle.plant import Plant, VehicleCommand
from vehicle.prescribed import ConstantSlipPlant
from vehicle.surface import Surface
from vehicle.truth import Truth

LOG_PERIOD = 10  # [ticks]; also how far the plant is integrated in one call, so that everything happens on these ticks


class Motive(Protocol):
    """Whatever moves the vehicle: a plant with tyres, or a prescribed motion."""

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray: ...

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray: ...

    def observe(self, state: FloatArray, tick: int) -> Truth: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Assembly:
    """The parts of one run."""

    scenario: Scenario
    seed: int
    vehicle: Vehicle
    trailer_unit: int  # which unit is watched and steered
    trailer: TrailerGeometry
    course: Course
    motive: Motive
    driver: PreviewDriver | None  # None: the motion is prescribed
    trailer_steering: TrailerSteering[Any]
    schedule: Schedule  # of the camera, or of the reference unit in its place
    sensor: PoseSensor
    source: OffTrackingSource
    cameras: Cameras | None  # None: nothing is rendered

    @property
    def steers_ahead(self) -> int:
        """Number of steered axles in front of the watched trailer's, as they come first in ``Truth.steer``."""
        return sum(len(unit.steered_axles) for unit in self.vehicle.units[: self.trailer_unit])


def assemble(scenario: Scenario, seed: int, *, keep_colour: bool = False, record: bool = False) -> Assembly:
    """The parts of the scenario's run with this seed; cameras are opened last, when all else has been accepted.

    Args:
        scenario: what to run.
        seed: decides world and noise.
        keep_colour: let frames carry what the left camera saw in colour.
        record: have cameras even if the off-tracking is not estimated from them.

    Raises:
        ValueError: one line, for whatever of the scenario does not fit.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    vehicle = load_vehicle(scenario.vehicle)
    unit = watched_unit(vehicle, scenario)
    trailer = trailer_geometry(vehicle, unit)
    course = course_of(scenario, vehicle)
    surface = surface_of(scenario, course, stream(seed, "surface"))
    steering = _constructed("trailer_steering", scenario.trailer_steering, TRAILER_STEERING, trailer, scenario.steering)
    motive, driver = _moved(scenario, vehicle, unit, course, surface)
    schedule = _schedule(scenario.rig)
    sensing = opened_sensing(
        scenario,
        seed,
        unit=unit,
        vehicle=vehicle,
        trailer=trailer,
        course=course,
        surface=surface,
        keep_colour=keep_colour,
        record=record,
    )
    return Assembly(
        scenario=scenario,
        seed=seed,
        vehicle=vehicle,
        trailer_unit=unit,
        trailer=trailer,
        course=course,
        motive=motive,
        driver=driver,
        trailer_steering=steering,
        schedule=schedule,
        sensor=sensing.sensor,
        source=sensing.source,
        cameras=sensing.cameras,
    )


def _moved(
    scenario: Scenario, vehicle: Vehicle, unit: int, course: Course, surface: Surface
) -> tuple[Motive, PreviewDriver | None]:
    """What moves the vehicle, and who drives it."""
    if not isinstance(scenario.course, ConstantSlipOptions):
        driver = PreviewDriver(tractor_geometry(vehicle, course), course.path, scenario.speed)
        return Plant(vehicle, surface), driver
    if scenario.trailer_steering != "none":
        raise ValueError(
            f"trailer_steering = {scenario.trailer_steering}: the trailer of {scenario.name} is dragged at a constant "
            "slip angle and can not be steered; use trailer_steering=none"
        )
    slip_angle = math.radians(scenario.course.slip_angle_deg)
    return ConstantSlipPlant(vehicle, surface, unit=unit, slip_angle=slip_angle, speed=scenario.speed), None


def _schedule(rig: RigOptions) -> Schedule:
    schedule = Schedule.at_rate(rig.rate_hz, latency=rig.latency, name="rig.rate_hz")
    for name, ticks in (("1/rig.rate_hz", schedule.period), ("rig.latency", schedule.latency)):
        if ticks % LOG_PERIOD:
            raise ValueError(f"{name} = {ticks * TICK:g} s must be a multiple of {LOG_PERIOD * TICK:g} s")
    return schedule


def _constructed(
    key: str, name: str, catalogue: dict[str, str], trailer: TrailerGeometry, parameters: dict[str, Parameter]
) -> Any:
    """The part of that name, given its own parameters by keyword; one it does not have is refused."""
    part = resolve(key, name, catalogue)
    known = [p.name for p in inspect.signature(part).parameters.values() if p.kind is not p.VAR_KEYWORD][1:]
    for parameter in parameters:
        if parameter not in known:
            raise ValueError(f"steering.{parameter}: {name} has no such parameter{nearest(parameter, known)}")
    try:
        return part(trailer, **parameters)
    except TypeError as error:
        raise ValueError(f"{key} = {name}: can not be constructed as {part.__name__}(trailer, ...): {error}") from error
