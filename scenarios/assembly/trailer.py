"""From a scenario to the parts of its run: everything is constructed, and refused if need be, before anything moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from controllers.driver import PreviewDriver
from controllers.driver_trace import TraceDriver
from controllers.reversing.chain import RollingChain
from controllers.shunting import ShuntingDriver, Stop
from controllers.trailer import Combination, TrailerGeometry, TrailerSteering
from controllers.trailer_steering.unsteered import Unsteered
from estimators.context import OffTrackingSource
from scenarios.assembly.adapters import (
    course_of,
    surface_of,
    tractor_geometry,
    trailer_geometry,
    vehicle_of,
    watched_units,
)
from scenarios.assembly.board_calibration import Told
from scenarios.assembly.courses import Course
from scenarios.assembly.recorded_drive import read_trace
from scenarios.assembly.sensing import Sensing, Sensor, opened_sensing
from scenarios.assembly.stereo_cameras import Cameras, Views, built_world, traffic_around
from scenarios.assembly.trailer_law import trailer_law
from scenarios.options.course import ConstantSlipOptions
from scenarios.options.rig import RigOptions
from scenarios.options.scenario import Scenario
from scenarios.randomness import stream
from sensors.instruments.combination import CombinationSensors
from vehicle.clock import TICK, Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.prescribed import ConstantSlipPlant
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

Driver = PreviewDriver | ShuntingDriver | TraceDriver
LOG_PERIOD = 10  # [ticks]; also how far the plant is integrated in one call, so that everything happens on these ticks


class Motive(Protocol):
    """Whatever moves the vehicle: a plant with tyres, or a prescribed motion."""

    def initial_state(self, pose: Pose2, speed: float) -> FloatArray:
        """State at a pose, rolling straight at a speed [m/s]."""

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State so many ticks later."""

    def observe(self, state: FloatArray, tick: int) -> Truth:
        """Ground truth for this state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchedTrailer:
    """A trailer whose off-tracking is estimated and judged, with its own steering law if it has steered axles."""

    unit: int  # its number in the vehicle
    name: str
    geometry: TrailerGeometry
    steers_ahead: int  # number of steered axles in front of its own, as they come first in ``Truth.steer``
    law: TrailerSteering[Any]
    signals: CombinationSensors
    sensing: Sensing

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        unit: int,
        geometry: TrailerGeometry,
        law: TrailerSteering[Any],
        signals: CombinationSensors,
        sensing: Sensing,
    ) -> WatchedTrailer:
        """The ``unit`` of a vehicle with what senses and steers it."""
        return cls(
            unit=unit,
            name=vehicle.units[unit].name,
            geometry=geometry,
            steers_ahead=sum(len(ahead.steered_axles) for ahead in vehicle.units[:unit]),
            law=law,
            signals=signals,
            sensing=sensing,
        )

    @property
    def n_steered(self) -> int:
        """Number of its steered axles."""
        return sum(self.geometry.steered)


@dataclass(frozen=True, slots=True, kw_only=True)
class Assembly:
    """The parts of one run; ``trailer`` and what else there is one of belong to the last trailer."""

    scenario: Scenario
    seed: int
    vehicle: Vehicle
    trailers: tuple[WatchedTrailer, ...]  # front to rear; the last is the vehicle's last unit
    course: Course
    motive: Motive
    driver: Driver | None  # None: the motion is prescribed
    schedule: Schedule  # of the cameras, or of the reference units in their place
    duration: float  # how long the drive should take [s]

    @property
    def is_recorded(self) -> bool:
        """Whether a recorded drive is repeated, wherever this leads."""
        return isinstance(self.driver, TraceDriver)

    @property
    def start_speed(self) -> float:
        """How fast the combination rolls at the start [m/s]."""
        told = self.driver.start_speed if isinstance(self.driver, TraceDriver) else None
        return self.scenario.speed if told is None else told

    @property
    def trailer_unit(self) -> int:
        """The last unit's number."""
        return self.trailers[-1].unit

    @property
    def trailer(self) -> TrailerGeometry:
        """The last trailer's data sheet."""
        return self.trailers[-1].geometry

    @property
    def sensor(self) -> Sensor:
        """What its off-tracking is estimated from."""
        return self.trailers[-1].sensing.sensor

    @property
    def source(self) -> OffTrackingSource:
        """What estimates it."""
        return self.trailers[-1].sensing.source

    @property
    def cameras(self) -> Cameras | None:
        """Its cameras, which own the renderer; None: nothing is rendered."""
        return self.trailers[-1].sensing.cameras


def assemble(
    scenario: Scenario,
    seed: int,
    *,
    keep_colour: bool = False,
    record: bool = False,
    calibrating: Told | None = None,
) -> Assembly:
    """The parts of the scenario's run with this seed; cameras are opened last, when all else has been accepted.

    Args:
        scenario: what to run.
        seed: decides world and noise.
        keep_colour: let frames of the last trailer carry what the left camera saw in colour.
        record: have cameras on the last trailer even if the off-tracking is not estimated from them.
        calibrating: told how many pictures of calibration boards are done, of how many.

    Raises:
        ValueError: one line, for whatever of the scenario does not fit.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    vehicle = vehicle_of(scenario)
    units = watched_units(vehicle, scenario)
    course = course_of(scenario, vehicle)
    surface = surface_of(scenario, course, stream(seed, "surface"))
    geometries = {unit: trailer_geometry(vehicle, unit) for unit in units}
    laws = {unit: _law(scenario, vehicle, unit, geometry) for unit, geometry in geometries.items()}
    motive, driver = _moved(scenario, vehicle, units[-1], course, surface)
    schedule = _schedule(scenario.rig)
    last = vehicle.units[units[-1]]
    traffic = traffic_around(scenario.traffic, last, geometries[units[-1]], surface, stream(seed, "traffic"))
    views = Views(lambda: built_world(scenario.world, course, surface, stream(seed, "world")), traffic)
    trailers = []
    for unit, geometry in reversed(geometries.items()):  # the last trailer's cameras own the renderer
        told = stream(seed, f"signals of {vehicle.units[unit].name}")
        signals = CombinationSensors(vehicle, unit, rng=told, noise=scenario.signals.noise)
        sensing = opened_sensing(
            scenario,
            seed,
            unit=unit,
            vehicle=vehicle,
            trailer=geometry,
            signals=signals,
            surface=surface,
            views=views,
            schedule=schedule,
            keep_colour=keep_colour and unit == units[-1],
            record=record and unit == units[-1],
            calibrating=calibrating,
        )
        trailers.append(WatchedTrailer.of(vehicle, unit, geometry, laws[unit], signals, sensing))
    return Assembly(
        scenario=scenario,
        seed=seed,
        vehicle=vehicle,
        trailers=tuple(reversed(trailers)),
        course=course,
        motive=motive,
        driver=driver,
        schedule=schedule,
        duration=driver.duration if driver else course.length / scenario.speed,
    )


def _law(scenario: Scenario, vehicle: Vehicle, unit: int, trailer: TrailerGeometry) -> TrailerSteering[Any]:
    """The scenario's law for one trailer; one without steered axles behind others that are steered stays as it is."""
    steered_ahead = any(ahead.steered_axles for ahead in vehicle.units[1:unit])
    if steered_ahead and not any(trailer.steered):
        return Unsteered(trailer)
    combination, degradation = Combination(vehicle, unit), scenario.degradation.degradation()
    parameters = dict(scenario.steering)
    if scenario.trailer_steering == "policy":
        if scenario.policy.path is None:
            raise ValueError("trailer_steering = policy: policy.path is missing, the file of its network")
        parameters["path"] = scenario.policy.path
    return trailer_law(scenario.trailer_steering, trailer, combination, parameters, degradation)


def _moved(
    scenario: Scenario, vehicle: Vehicle, unit: int, course: Course, surface: Surface
) -> tuple[Motive, Driver | None]:
    """What moves the vehicle, and who drives it."""
    if not isinstance(scenario.course, ConstantSlipOptions):
        return Plant(vehicle, surface), _driver(scenario, vehicle, course)
    if scenario.trailer_steering != "none":
        raise ValueError(
            f"trailer_steering = {scenario.trailer_steering}: the trailer of {scenario.name} is dragged at a constant "
            "slip angle and can not be steered; use trailer_steering=none"
        )
    slip_angle = math.radians(scenario.course.slip_angle_deg)
    return ConstantSlipPlant(vehicle, surface, unit=unit, slip_angle=slip_angle, speed=scenario.speed), None


def _driver(scenario: Scenario, vehicle: Vehicle, course: Course) -> Driver:
    """Who drives: along the course, or as recorded."""
    options = scenario.driver
    if options.trace is not None:
        if options.stops:
            raise ValueError("driver.stops and driver.trace: a recorded drive has its own stops")
        return TraceDriver(read_trace(Path(options.trace)))
    limit = math.inf if options.max_lateral_acceleration is None else options.max_lateral_acceleration
    tractor = tractor_geometry(vehicle, course)
    driver = PreviewDriver(tractor, course.path, scenario.speed, max_lateral_acceleration=limit)
    if not options.stops:
        return driver
    try:
        return ShuntingDriver(
            driver, RollingChain.of(vehicle), [Stop(stop.station, stop.wait, stop.back) for stop in options.stops]
        )
    except ValueError as error:
        raise ValueError(f"driver.{error}") from error


def _schedule(rig: RigOptions) -> Schedule:
    schedule = Schedule.at_rate(rig.rate_hz, latency=rig.latency, name="rig.rate_hz")
    for name, ticks in (("1/rig.rate_hz", schedule.period), ("rig.latency", schedule.latency)):
        if ticks % LOG_PERIOD:
            raise ValueError(f"{name} = {ticks * TICK:g} s must be a multiple of {LOG_PERIOD * TICK:g} s")
    return schedule
