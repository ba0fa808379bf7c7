"""Assembly of a rover run with its sensors: all parts are constructed and checked before the simulation starts."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from controllers.checked import CheckedRoverDriver
from controllers.path import Path
from controllers.rover_driver import RoverDriverContext, RoverDriverLike, RoverDriverPart
from estimators.context import RoverContext, RoverGeometry, SlipEstimator
from estimators.odometry.repeated_frames import NewViews
from scenarios import catalogue
from scenarios.assembly.adapters import rig_schedule
from scenarios.assembly.applied_faults import refuse_loop_faults, sensor_faults
from scenarios.assembly.unreached import rover_unreached
from scenarios.options.scenario import RoverScenario, RoverSurfaceOptions, SandOptions, stream
from scenarios.progress import Progress, no_progress
from sensors.context import RoverSensorContext
from sensors.faults.fault import with_faults
from sensors.instruments.navigation import ExactSlip, LaserTracker, RoverInstruments
from sensors.messages import Message, RoverReadings, RoverView, Sensor, check_receives
from sensors.sand.trace_camera import TraceCamera, Webcam
from sensors.sand.trace_rig import TraceRig, nominal_rig
from sensors.sand.world import SandWorld, Sun
from vehicle.clock import Schedule
from vehicle.foundation.own_parts import close_part
from vehicle.rover.description import Rover, load_rover, load_soil
from vehicle.rover.plant import RoverPlant
from vehicle.rover.terrain import HeightMap, Mound, Terrain, load_height_map
from vehicle.rover.truth import RoverTruth


class ReadOnce:
    """Instruments with one reading per tick: all users receive the same errors."""

    def __init__(self, instruments: RoverInstruments) -> None:
        self._instruments = instruments
        self._last: RoverReadings | None = None

    def sample(self, truth: RoverTruth) -> RoverReadings:
        """Readings at this tick."""
        if self._last is None or self._last.tick != truth.tick:
            self._last = self._instruments.sample(truth)
        return self._last


class TraceView:
    """The camera over the sand with encoders and compass; the sand keeps the imprints of the wheels."""

    def __init__(self, world: SandWorld, camera: TraceCamera, instruments: ReadOnce) -> None:
        self.camera = camera
        self._world, self._instruments = world, instruments
        self._driven: list[RoverTruth] = []  # since the last image, without what is imprinted
        self._is_first = True  # True until the second motion after an image

    def follow(self, truth: RoverTruth) -> None:
        """Imprint the wheels' motion, and make sand ahead, while the estimator works on the last image."""
        if self._driven:
            self._world.drive(self._driven, after=truth)
            if self._is_first:
                self._world.prepare(truth)
            self._is_first = False
        self._driven = [truth]

    def see(self, channel: int, message: object, truth: RoverTruth) -> None:
        """Ignore messages: they do not change the sand."""

    def sample(self, truth: RoverTruth) -> RoverView:
        """Imprint the rest of the wheels' motion since the last image, and take the view."""
        self._world.drive(self._driven)
        self._driven, self._is_first = [], True
        return self._instruments.sample(truth).seen(self.camera.sample(truth))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverMountContext(RoverSensorContext):
    """Context of the built-in sensors, with the options that they read."""

    webcam: Webcam
    path: Path  # reference path; the rover follows it roughly
    rig: TraceRig
    build_world: Callable[[], SandWorld]
    instruments: ReadOnce
    stream: Callable[[str], np.random.Generator]  # random stream of the run, by name


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedRoverSensor:
    """A sensor that is ready to sample."""

    sensor: Sensor[RoverTruth, Message]
    schedule: Schedule
    view: TraceView | None = None  # None: not a camera


class TraceCameraSensor:
    """The camera behind the left rear wheel, with encoders and compass."""

    @classmethod
    def of(cls, context: RoverMountContext) -> OpenedRoverSensor:
        """Camera of the rover's rig."""
        world = context.build_world()
        camera = TraceCamera(world, context.rig, context.webcam, context.stream("camera noise"))
        view = TraceView(world, camera, context.instruments)
        return OpenedRoverSensor(sensor=view, schedule=context.schedule, view=view)


class SlipInstrument:
    """An instrument that measures the slip angle without error, at the rate of the camera."""

    @classmethod
    def of(cls, context: RoverMountContext) -> OpenedRoverSensor:
        """Exact instrument."""
        return OpenedRoverSensor(sensor=ExactSlip(context.rig.watched), schedule=context.schedule)


PERIOD = 50  # period of control, log and one integration call [ticks]
_GRID = 0.1  # grid spacing of ground with a transition to a slope [m]
_LEVEL, _SLOPING, _HALF_WIDTH = 1.0, 20.0, 20.0  # its extent: level, beyond the transition, to each side [m]
_ROUTE = 0.1  # distance between route points around which the ground is built [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverSensing:
    """A sensor with its faults, and its slip estimator."""

    sensor: Sensor[RoverTruth, Message]
    schedule: Schedule
    estimator: NewViews
    view: TraceView | None  # the camera; None: the sensor is not a camera


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverAssembly:
    """The parts of one run."""

    scenario: RoverScenario
    seed: int
    rover: Rover
    geometry: RoverGeometry
    path: Path
    plant: RoverPlant
    driver: RoverDriverLike[Any]
    instruments: ReadOnce
    laser: LaserTracker
    sensing: RoverSensing
    rig: TraceRig
    recording: TraceView | None  # a camera that only records
    remarks: tuple[str, ...] = ()  # on the inputs, for the result's warnings

    @property
    def view(self) -> TraceView | None:
        """The camera; None if there is none."""
        return self.sensing.view or self.recording

    def close(self) -> None:
        """Close the driver and the estimator."""
        close_part(self.driver)
        close_part(self.sensing.estimator)


def assemble_rover(
    scenario: RoverScenario,
    seed: int,
    *,
    keep_colour: bool = False,
    record: bool = False,
    progress: Progress = no_progress,
) -> RoverAssembly:
    """Construct the parts of a run.

    Args:
        scenario: the scenario.
        seed: decides sand and noise.
        keep_colour: changes nothing: the camera renders again in colour what is kept.
        record: add a camera if the slip estimator uses none.
        progress: is not called: there is no calibration with boards.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    rover = load_rover(scenario.vehicle)
    geometry, path, terrain = rover_geometry(rover), rover_path(scenario), terrain_of(scenario.surface)
    soil = None if scenario.surface.soil == "none" else load_soil(scenario.surface.soil)
    driver = _driver(scenario, geometry, path)
    mount = rover_mount(scenario, rover, terrain, path, seed=seed)
    sensing = rover_sensing(scenario, mount)
    return RoverAssembly(
        scenario=scenario,
        seed=seed,
        rover=rover,
        geometry=geometry,
        path=path,
        plant=RoverPlant(rover, terrain, soil),
        driver=driver,
        instruments=mount.instruments,
        laser=LaserTracker(rng=stream(seed, "laser tracker"), scale=scenario.signals.noise),
        sensing=sensing,
        rig=mount.rig,
        recording=TraceCameraSensor.of(mount).view if record and sensing.view is None else None,
        remarks=rover_unreached(scenario.surface, path, terrain.height_map, rover.wheelbase),
    )


def rover_mount(
    scenario: RoverScenario, rover: Rover, terrain: Terrain, path: Path, *, seed: int, signal_noise: float = 1.0
) -> RoverMountContext:
    """Context of the rover's sensors; ``signal_noise`` multiplies the scenario's ``signals.noise``."""
    scale = signal_noise * scenario.signals.noise
    return RoverMountContext(
        rover=rover,
        schedule=rig_schedule(scenario.rig, PERIOD),
        rng=stream(seed, "sensor"),
        options=scenario.sensing,
        webcam=Webcam(read_noise=scenario.rig.noise, shot_noise=scenario.rig.shot_noise),
        path=path,
        rig=nominal_rig(rover),
        build_world=lambda: sand_world(scenario.world, stream(seed, "sand"), rover, terrain, path),
        instruments=ReadOnce(RoverInstruments(rng=stream(seed, "rover instruments"), scale=scale)),
        stream=partial(stream, seed),
    )


def rover_sensing(scenario: RoverScenario, mount: RoverMountContext) -> RoverSensing:
    """Open the scenario's sensor and slip estimator.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    part: type[SlipEstimator] = catalogue.resolve("slip_estimator", scenario.slip_estimator, catalogue.SLIP_ESTIMATOR)
    sensor = part.sensor if scenario.sensor is None else scenario.sensor
    if sensor == "trace_camera" and scenario.surface.soil == "none" and scenario.slip_estimator != "truth":
        raise ValueError(
            f"slip_estimator = {scenario.slip_estimator}: hard ground (surface.soil = none) shows no wheel trace"
        )
    opened: OpenedRoverSensor = catalogue.opened_sensor(sensor, mount, catalogue.ROVER_SENSOR, OpenedRoverSensor)
    context = RoverContext(
        rover=rover_geometry(mount.rover), rig=mount.rig, rng=mount.stream("slip estimator"), options=scenario.estimator
    )
    estimator = catalogue.constructed("slip_estimator", scenario.slip_estimator, lambda: part.of(context))
    catalogue.check_made("slip_estimator", scenario.slip_estimator, estimator, ("init", "step"))
    check_receives(f"slip_estimator = {scenario.slip_estimator}", estimator, opened.sensor)
    refuse_loop_faults(scenario.faults, "a rover")
    return RoverSensing(
        sensor=with_faults(
            opened.sensor,
            [fault for _, fault in sensor_faults(scenario.faults)],
            camera=mount.rig.camera,
            unit=0,
            rng=lambda k: mount.stream(f"fault {k}"),
        ),
        schedule=opened.schedule,
        estimator=NewViews(estimator, mount.rig.wheel_radius),
        view=opened.view,
    )


def rover_path(scenario: RoverScenario) -> Path:
    """The path of a rover's course.

    Raises:
        ValueError: one line, if the course is not consistent.
    """
    kind = scenario.course.kind
    path = catalogue.constructed("course.kind", kind, scenario.course.path)
    if not isinstance(path, Path):
        raise ValueError(f"course.kind = {kind}: made a {type(path).__name__}, not a controllers.path.Path")
    return path


def _driver(scenario: RoverScenario, geometry: RoverGeometry, path: Path) -> RoverDriverLike[Any]:
    part: type[RoverDriverPart[Any]] = catalogue.resolve("driver", scenario.driver, catalogue.ROVER_DRIVER)
    context = RoverDriverContext(
        rover=geometry,
        path=path,
        speed=scenario.speed,
        compensation=scenario.slip_compensation,
        options=scenario.driving,
    )
    driver = catalogue.constructed("driver", scenario.driver, lambda: part.of(context))
    catalogue.check_made("driver", scenario.driver, driver, ("init", "step"))
    return CheckedRoverDriver(driver, f"driver = {scenario.driver}", len(geometry.places()))


def rover_geometry(rover: Rover) -> RoverGeometry:
    """The rover's data sheet for its odometry and driver."""
    return RoverGeometry(
        wheels=rover.places,
        wheel_radius=rover.radius,
        effective_track=rover.tread if rover.steered else rover.effective_track,
        max_steer=tuple(rover.steer_limit if wheel.steered else 0.0 for wheel in rover.wheels),
        max_wheel_speed=rover.no_load_speed,
    )


def terrain_of(options: RoverSurfaceOptions) -> Terrain:
    """The shape of the ground.

    Raises:
        ValueError: one line, if the height map cannot be read, or if surface.slope_from is given as well.
    """
    heights, everywhere = None, options.slope_from is None
    if options.slope_from is not None:
        if options.height_map:
            raise ValueError(
                "surface.slope_from and surface.height_map: give only one of them; put the slope into the map"
            )
        heights = _slope_transition(options, options.slope_from)
    elif options.height_map:
        heights = load_height_map(
            options.height_map, options.height_map_spacing, x=options.height_map_x, y=options.height_map_y
        )
    return Terrain(
        slope_x=options.grade if everywhere else 0.0,
        slope_y=options.cross_fall if everywhere else 0.0,  # it falls to the right, so it rises to the left
        friction=options.friction,
        mounds=tuple(Mound(x=m.x, y=m.y, height=m.height, radius=m.radius) for m in options.mounds),
        height_map=heights,
    )


def _slope_transition(options: RoverSurfaceOptions, begin: float) -> HeightMap:
    """Level ground with a smooth transition to the slopes; it begins at x = ``begin`` [m]."""
    x = np.arange(begin - _LEVEL, begin + options.slope_over + _SLOPING, _GRID)
    y = np.arange(-_HALF_WIDTH, _HALF_WIDTH + 0.5 * _GRID, _GRID)
    share = np.clip((x - begin) / options.slope_over, 0.0, 1.0)
    share = share**2 * (3.0 - 2.0 * share)
    along = np.concatenate([[0.0], np.cumsum(0.5 * (share[1:] + share[:-1]) * _GRID)])
    heights = options.grade * along + options.cross_fall * share * y[:, None]
    return HeightMap(heights=heights, spacing=_GRID, x=float(x[0]), y=float(y[0]))


def sand_world(options: SandOptions, rng: np.random.Generator, rover: Rover, terrain: Terrain, path: Path) -> SandWorld:
    """The sand around a path; ``rng`` determines everything that the options leave open.

    Raises:
        ValueError: one line, if only one angle of the sun is given.
    """
    azimuth, elevation = options.sun_azimuth_deg, options.sun_elevation_deg
    if (azimuth is None) != (elevation is None):
        raise ValueError(
            "world.sun_azimuth_deg and world.sun_elevation_deg: give both or neither (decided by the seed)"
        )
    sun = None
    if azimuth is not None and elevation is not None:
        sun = Sun(azimuth=math.radians(90.0 - azimuth), elevation=math.radians(elevation))
    route = path.points(_ROUTE)
    return SandWorld(options.terrain, rng=rng, rover=rover, terrain=terrain, route=route, sun=sun)
