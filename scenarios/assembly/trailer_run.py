"""Assembly of a trailer run: all parts are constructed and checked before the simulation starts."""

import math
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from controllers.driver import DriverTrace
from controllers.trailer import Combination, TrailerGeometry
from controllers.trailer_steering.lqr import AllSpeeds
from controllers.trailer_steering.safeguarded import Safeguarded
from estimators.calibration.self_calibration import SelfCalibratedOdometry
from estimators.context import FusesSignals, Odometry, OffTrackingEstimator, OffTrackingSource, TrailerContext
from estimators.off_tracking.viso_ot import VisoOt
from scenarios.assembly import adapters, applied_faults
from scenarios.assembly.drivers_and_laws import OpenedDriver, opened_driver, steering_parameters, trailer_law
from scenarios.assembly.trailer_sensors import (
    SIGNALS,
    Cameras,
    MountContext,
    OpenedSensor,
    Rectified,
    StereoCameras,
    Views,
    built_world,
    traffic_around,
)
from scenarios.assembly.unreached import unreached
from scenarios.catalogue import ODOMETRY, OFF_TRACKING, SENSOR, check_made, constructed, opened_sensor, resolve
from scenarios.courses import Course
from scenarios.options.scenario import Scenario, stream
from scenarios.options.tables import SurfaceOptions
from scenarios.progress import Progress, no_progress
from scenarios.roads.crg_file import CrgSurface, read_crg
from sensors.faults.fault import Fault, with_faults
from sensors.faults.message_kinds import SignalFault
from sensors.instruments.combination import CombinationSensors, TrailerViewSensor
from sensors.messages import Message, Sensor, StereoFrame, check_receives
from vehicle.clock import Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.foundation.own_parts import close_part
from vehicle.frames import FloatArray, dense
from vehicle.option import Parameter, check_options, declared_options
from vehicle.surface import PATCH_SPREAD, MeasuredRoad, Surface

_SPACING: Final = 0.25  # between points of the line [m]
_BEFORE_START: Final = 100.0  # length of line that holds the start of the path [m]
_HIGHEST: Final = 0.5  # unevenness that a wheel may roll over [m]


def measured_ground(options: SurfaceOptions, course: Course) -> tuple[MeasuredRoad | None, tuple[str, ...]]:
    """The surface of ``surface.crg`` along a course, None if there is none, and what a user should know of it.

    Raises:
        ValueError: one line, if the file cannot be read, or has steps that no wheel rolls over.
    """
    if options.crg is None:
        return None, ()
    try:
        surface = read_crg(Path(options.crg))
    except ValueError as error:
        raise ValueError(f"surface.crg = {error}") from None
    try:
        line, _ = dense(course.centreline, _SPACING)
        road = MeasuredRoad(
            line,
            surface.heights,
            u_step=surface.u_step,
            v=surface.v,
            start=options.crg_start + _path_start(line, course) + surface.u_start,
            beyond=options.crg_beyond,
            tyre_spread=PATCH_SPREAD,
        )
    except ValueError as error:
        raise ValueError(f"surface.crg = {options.crg}: {error}") from None
    if road.highest > _HIGHEST:
        raise ValueError(
            f"surface.crg = {options.crg}: is {road.highest:.2f} m higher or lower than its mean profile: must be at "
            f"most {_HIGHEST:g} m (heights are metres)"
        )
    end = options.crg_start + (len(surface.heights) - 1) * surface.u_step
    return road, tuple(_remarks(surface, course, options, end))


def _path_start(line: FloatArray, course: Course) -> float:
    """Station of the line beside which the guided point starts [m]."""
    first = line[: int(_BEFORE_START / _SPACING)]
    return int(np.argmin(np.hypot(*(first - np.array(course.path.start[:2])).T))) * float(math.dist(line[0], line[1]))


def _remarks(surface: CrgSurface, course: Course, options: SurfaceOptions, end: float) -> list[str]:
    """One line for each way in which the file, which ends at a station of the course, does not cover the road."""
    remarks = []
    if options.crg_beyond == "level" and not (end > 0.0 and options.crg_start < course.length):
        remarks.append(
            f"surface.crg_start = {options.crg_start:g} m: the course of {course.length:.1f} m never meets the "
            f"measured surface, which ends at {end:.1f} m"
        )
    if surface.missing:
        remarks.append(
            f"surface.crg: {100.0 * surface.missing:.2g} % of its heights are missing: filled in from beside"
        )
    left, right = np.broadcast_to(course.road_half_width, (len(course.centreline), 2)).max(axis=0).tolist()
    if surface.v[-1] < left - 0.01 or -surface.v[0] < right - 0.01:
        remarks.append(
            f"surface.crg: reaches from {surface.v[0]:.2f} to {surface.v[-1]:+.2f} m across, the road from "
            f"{-right:.2f} to {left:+.2f} m: beside it the height of its edge goes on"
        )
    return remarks


def opened_ground(scenario: Scenario, course: Course, seed: int) -> tuple[Surface, tuple[str, ...]]:
    """The surface of a scenario, whose roughness the seed decides, and what a user should know of its measured road.

    Raises:
        ValueError: one line, if a file cannot be read.
    """
    measured, remarks = measured_ground(scenario.surface, course)
    return adapters.surface_of(scenario, course, stream(seed, "surface"), measured), remarks


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensing:
    """A sensor with its faults, and its estimator."""

    sensor: Sensor[Truth, Message]
    schedule: Schedule
    period: int  # between two of its messages [ticks]
    estimator: OffTrackingSource
    cameras: Cameras | None  # None: the estimator receives no stereo images


def rendered_images(scenario: Scenario) -> type | None:
    """Class of the images of a scenario's cameras, which are rendered with OpenGL; None: its sensor is no camera."""
    sensor = scenario.sensor or resolve("off_tracking", scenario.off_tracking, OFF_TRACKING).sensor
    sends = getattr(resolve("sensor", sensor, SENSOR), "sends", None)
    return sends if isinstance(sends, type) else None


def course_duration(scenario: Scenario) -> float:
    """Time that a scenario's course takes at set speed [s]."""
    return adapters.course_of(scenario, adapters.vehicle_of(scenario)).length / scenario.speed


def opened_sensing(scenario: Scenario, context: MountContext) -> Sensing:
    """Open the scenario's sensor and estimator for one trailer.

    Raises:
        ValueError: one line, if the scenario is not consistent.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    part: type[OffTrackingEstimator] = resolve("off_tracking", scenario.off_tracking, OFF_TRACKING)
    options = _estimator_options(scenario)
    check_options(declared_options(part), options, "estimator")
    sensor = scenario.sensor if scenario.sensor is not None else part.sensor
    if hasattr(kind := resolve("sensor", sensor, SENSOR), "sends"):  # cameras take seconds to open
        check_receives(f"off_tracking = {scenario.off_tracking}", part, kind)
    opened: OpenedSensor = opened_sensor(sensor, context, SENSOR, OpenedSensor)
    cameras = opened.cameras
    odometry: Odometry[Any] | None = None
    if cameras and cameras.epipolar:
        motions, calibration = resolve("odometry", scenario.odometry, ODOMETRY), cameras.calibration
        odometry = constructed("odometry", scenario.odometry, lambda: motions(calibration))
    if odometry and cameras:
        correcting = scenario.rig.self_calibration
        odometry = SelfCalibratedOdometry(cameras.calibration, odometry, correcting=correcting)
    known = TrailerContext(
        vehicle=context.nominal,
        unit=context.unit,
        follow_distance=context.trailer.follow_distance,
        calibration=cameras.calibration if cameras else None,
        odometry=odometry,
        rng=context.stream(scenario.off_tracking),
        options=options,
        sensor=opened.sensor,
    )
    estimator = constructed("off_tracking", scenario.off_tracking, lambda: part.of(known))
    check_made("off_tracking", scenario.off_tracking, estimator, ("init", "step"))
    check_receives(f"off_tracking = {scenario.off_tracking}", estimator, opened.sensor)
    sensing = Sensing(
        sensor=_with_faults(opened, applied_faults.sensor_faults(scenario.faults), context),
        schedule=opened.schedule,
        period=opened.schedule.period,
        estimator=Rectified(estimator, cameras.rectifier) if cameras and cameras.rectifier else estimator,
        cameras=cameras,
    )
    fuses = isinstance(estimator, FusesSignals) and estimator.fuses_signals
    return _with_signals(sensing, context) if fuses and cameras else sensing


def _with_signals(sensing: Sensing, context: MountContext) -> Sensing:
    """The same with views of the trailer, frames and signals, instead of frames alone."""
    camera = cast("Sensor[Truth, StereoFrame]", sensing.sensor)  # what cameras of a stereo odometry send
    views = TrailerViewSensor(camera, sensing.schedule, context.signals, SIGNALS)
    return replace(sensing, sensor=views, schedule=views.schedule)


def _estimator_options(scenario: Scenario) -> dict[str, Parameter]:
    """Parameters of the estimator: ``viso_ot.…`` for viso_ot, ``estimator.…`` for the others."""
    if scenario.off_tracking == "viso_ot":
        return scenario.viso_ot.model_dump()
    if scenario.viso_ot != VisoOt.Parameters():
        raise ValueError(f"viso_ot.* options apply only to off_tracking = viso_ot, not to {scenario.off_tracking}")
    return dict(scenario.estimator)


def _with_faults(
    opened: OpenedSensor, faults: list[tuple[int, Fault]], context: MountContext
) -> Sensor[Truth, Message]:
    """The sensor with the scenario's ``faults``, applied in their order; those of signals act on the own sensors."""
    of_signals = [(k, fault) for k, fault in faults if issubclass(fault.kind, SignalFault)]
    of_sensor = [(k, fault) for k, fault in faults if not issubclass(fault.kind, SignalFault)]
    context.signals.fail([fault for _, fault in of_signals], lambda k: context.stream(f"fault {of_signals[k][0]}"))
    return with_faults(
        opened.sensor,
        [fault for _, fault in of_sensor],
        camera=opened.cameras.calibration if opened.cameras else None,
        unit=context.unit,
        rng=lambda k: context.stream(f"fault {of_sensor[k][0]}"),
    )


LOG_PERIOD = 10  # period of the log and of one integration call; all events are on its multiples [ticks]


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchedTrailer:
    """A trailer whose off-tracking is estimated and judged, with its own steering law if it has steered axles."""

    unit: int  # its index in the vehicle
    name: str
    geometry: TrailerGeometry
    path_height: float  # of the points that off-tracking is about, in its body [m]
    steers_ahead: int  # number of steered axles ahead of its own, which come first in ``Truth.steer``
    law: Safeguarded
    signals: CombinationSensors
    sensing: Sensing
    faults: applied_faults.LoopFaults = field(default_factory=applied_faults.LoopFaults)

    @property
    def n_steered(self) -> int:
        """Number of its steered axles."""
        return sum(self.geometry.steered)

    def close(self) -> None:
        """Close law and estimator."""
        close_part(self.law)
        close_part(self.sensing.estimator)


@dataclass(frozen=True, slots=True, kw_only=True)
class Assembly:
    """The parts of one run."""

    scenario: Scenario
    seed: int
    vehicle: Vehicle  # the simulated one
    trailers: tuple[WatchedTrailer, ...]  # front to rear; the last is the vehicle's last unit
    course: Course
    surface: Surface
    plant: adapters.CombinationPlant
    driver: OpenedDriver | None  # None: the motion is prescribed
    views: Views
    recording: OpenedSensor | None  # recording cameras of the last trailer
    brake_faults: applied_faults.LoopFaults
    schedule: Schedule  # of the cameras, or of the reference units instead
    remarks: tuple[str, ...] = ()  # on the inputs, for the result's warnings

    @property
    def cameras(self) -> Cameras | None:
        """Cameras of the last trailer; None if it has none."""
        return self.recording.cameras if self.recording else self.trailers[-1].sensing.cameras

    @property
    def trace(self) -> DriverTrace | None:
        """The recorded drive that is repeated."""
        return self.driver.trace if self.driver else None

    @property
    def duration(self) -> float:
        """Planned duration of the drive [s]."""
        return self.driver.duration if self.driver else self.course.length / self.scenario.speed

    @property
    def start_speed(self) -> float:
        """Speed of the combination at the start [m/s]."""
        return self.driver.start_speed if self.driver else self.scenario.speed

    def close(self) -> None:
        """Close the parts that hold a process or a file, and the renderer."""
        for trailer in self.trailers:
            trailer.close()
        if self.driver:
            close_part(self.driver.driver)
        close_part(self.plant)
        self.views.close()


def assemble(
    scenario: Scenario, seed: int, *, keep_colour: bool = False, record: bool = False, progress: Progress = no_progress
) -> Assembly:
    """Construct the parts of a run; cameras are opened last, after all other checks.

    Args:
        scenario: the scenario.
        seed: decides world and noise.
        keep_colour: add the left camera's colour image to frames of the last trailer.
        record: add cameras to the last trailer if its estimator uses none.
        progress: progress of the calibration with boards.

    Raises:
        ValueError: one line, if the scenario is not consistent.
        RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
    """
    with ExitStack() as opened:
        parts = _assembled(scenario, seed, opened, keep_colour=keep_colour, record=record, progress=progress)
        opened.pop_all()
        return parts


def _assembled(
    scenario: Scenario, seed: int, opened: ExitStack, *, keep_colour: bool, record: bool, progress: Progress
) -> Assembly:
    """The parts of a run; ``opened`` closes those that are there when a later one is refused."""
    nominal = adapters.vehicle_of(scenario)
    kind = adapters.plant_kind(scenario)
    simulated = applied_faults.with_failing_brakes(scenario, adapters.plant_vehicle(scenario), kind)
    units = adapters.watched_units(nominal)
    course = adapters.course_of(scenario, nominal)
    surface, remarks = opened_ground(scenario, course, seed)
    geometries = {unit: adapters.trailer_geometry(nominal, unit) for unit in units}
    laws: dict[int, Safeguarded] = {}
    for unit, geometry in geometries.items():
        laws[unit] = _law(scenario, nominal, unit, geometry)
        opened.callback(close_part, laws[unit])
    plant = adapters.opened_plant(scenario, simulated, surface)
    brakes = applied_faults.opened_brake_faults(scenario, simulated, partial(stream, seed))
    streams = {unit: partial(trailer_stream, seed, simulated, unit) for unit in units}
    faults = {
        unit: applied_faults.opened_trailer_faults(scenario, simulated, unit, kind, streams[unit]) for unit in units
    }
    driver = None if kind == "constant_slip" else opened_driver(scenario, nominal, course)
    opened.callback(close_part, driver.driver if driver else None)
    schedule = adapters.rig_schedule(scenario.rig, LOG_PERIOD)
    last = units[-1]
    traffic = traffic_around(scenario.traffic, nominal.units[last], geometries[last], surface, stream(seed, "traffic"))
    views = Views(lambda: built_world(scenario.world, course, surface, stream(seed, "world")), traffic)
    opened.callback(views.close)

    def mount(unit: int) -> MountContext:
        own = streams[unit]
        signals = stream(seed, f"signals of {simulated.units[unit].name}")
        return MountContext(
            vehicle=simulated,
            unit=unit,
            follow_distance=geometries[unit].follow_distance,
            surface=surface,
            views=views,
            nominal=nominal,
            schedule=schedule,
            rng=own("sensor"),
            options=scenario.sensing,
            rig=scenario.rig,
            ground_rig=scenario.ground_rig,
            ground=scenario.surface,
            trailer=geometries[unit],
            signals=CombinationSensors(simulated, unit, rng=signals, noise=scenario.signals.noise),
            stream=own,
            keep_colour=keep_colour and unit == last,
            progress=progress,
        )

    mounts = {unit: mount(unit) for unit in units}
    sensing: dict[int, Sensing] = {}
    for unit in reversed(units):  # the last owns the renderer
        sensing[unit] = opened_sensing(scenario, mounts[unit])
        opened.callback(close_part, sensing[unit].estimator)
    records_only = record and sensing[last].cameras is None
    recording = StereoCameras.of(mounts[last]) if records_only else None
    return Assembly(
        scenario=scenario,
        seed=seed,
        vehicle=simulated,
        trailers=tuple(
            WatchedTrailer(
                unit=unit,
                name=nominal.units[unit].name,
                geometry=geometries[unit],
                path_height=nominal.units[unit].roll_axis_height,
                steers_ahead=nominal.law_axles(unit).start,
                law=laws[unit],
                signals=mounts[unit].signals,
                sensing=sensing[unit],
                faults=faults[unit],
            )
            for unit in units
        ),
        course=course,
        surface=surface,
        plant=plant,
        driver=driver,
        views=views,
        recording=recording,
        brake_faults=brakes,
        schedule=schedule,
        remarks=(*course.remarks, *remarks, *unreached(scenario, course.path, nominal.length)),
    )


def trailer_stream(seed: int, vehicle: Vehicle, unit: int, name: str) -> np.random.Generator:
    """Random stream of one trailer; the last trailer's streams do not contain its name."""
    is_last = unit == len(vehicle.units) - 1
    return stream(seed, name if is_last else f"{name} of {vehicle.units[unit].name}")


def _law(scenario: Scenario, vehicle: Vehicle, unit: int, trailer: TrailerGeometry) -> Safeguarded:
    """The scenario's law for one trailer; ``none`` for a trailer without steered axles behind steered ones."""
    steered_ahead = any(ahead.steered_axles for ahead in vehicle.units[1:unit])
    combination, degradation = Combination(vehicle, unit), scenario.degradation
    if steered_ahead and not any(trailer.steered):
        return trailer_law("none", trailer, combination, {})
    parameters = steering_parameters(scenario)
    law = trailer_law(scenario.trailer_steering, trailer, combination, parameters, degradation)
    if isinstance(law.law, AllSpeeds):
        law.law.prepare(scenario.speed)
    return law
