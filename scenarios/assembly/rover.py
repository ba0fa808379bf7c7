"""From a rover's scenario to the parts of its run: constructed, and refused if need be, before anything moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from controllers.checked import CheckedRoverDriver
from controllers.path import Path
from controllers.rover_driver import RoverDriverContext, RoverDriverLike, RoverDriverPart
from estimators.context import RoverContext, SlipEstimator
from estimators.rover_geometry import RoverGeometry
from scenarios.assembly.rover_sensors import (
    ReadOnce,
    RoverMountContext,
    TraceCameraSensor,
    TraceView,
    opened_rover_sensor,
)
from scenarios.catalogue import ROVER_DRIVER, SLIP_ESTIMATOR, check_declared, constructed, resolve
from scenarios.options.rover import RoverScenario, RoverSurfaceOptions, SandOptions, TraceRigOptions
from scenarios.randomness import stream
from sensors.faults.faulty_sensor import with_faults
from sensors.instruments.rover_navigation import LaserTracker, RoverInstruments
from sensors.sand.rig import nominal_rig
from sensors.sand.trace_rig import TraceRig
from sensors.sand.world import SandWorld, Sun
from sensors.sensor import Message, Sensor
from vehicle.clock import TICK, Schedule
from vehicle.rover.description import Rover, load_rover
from vehicle.rover.height_map import HeightMap, load_height_map
from vehicle.rover.plant import RoverPlant
from vehicle.rover.soil import load_soil
from vehicle.rover.terrain import Mound, Terrain
from vehicle.rover.truth import RoverTruth

PERIOD = 50  # of control and log, and how far the plant is integrated in one call [ticks]
_GRID, _LEVEL, _SLOPING, _BESIDE = 0.1, 1.0, 20.0, 20.0  # of ground whose slopes set in: its mesh and extent [m]
_ROUTE = 0.1  # between points of the way that the ground is laid out along [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverSensing:
    """A sensor with its faults, and the slip estimator behind it."""

    sensor: Sensor[RoverTruth, Message]
    schedule: Schedule
    estimator: SlipEstimator
    view: TraceView | None  # the camera behind it; None: it is no camera


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

    @property
    def view(self) -> TraceView | None:
        """The camera; None: nothing is looked at."""
        return self.sensing.view or self.recording


def assemble_rover(scenario: RoverScenario, seed: int, *, record: bool = False) -> RoverAssembly:
    """Construct the parts of a run; ``record``: have a camera even if the slip is not estimated from it.

    Raises:
        ValueError: one line, for whatever of the scenario does not fit.
    """
    rover = load_rover(scenario.vehicle)
    geometry, path, terrain = rover_geometry(rover), scenario.course.path(), terrain_of(scenario.surface)
    soil = None if scenario.surface.soil == "none" else load_soil(scenario.surface.soil)
    driver = _driver(scenario, geometry, path)
    mount = rover_mount(scenario, rover, terrain, path, seed=seed)
    sensing = rover_sensing(mount)
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
    )


def rover_mount(
    scenario: RoverScenario, rover: Rover, terrain: Terrain, path: Path, *, seed: int, signal_noise: float = 1.0
) -> RoverMountContext:
    """Context of the rover's sensors; ``signal_noise`` scales the errors of its instruments over the scenario's."""
    scale = signal_noise * scenario.signals.noise
    return RoverMountContext(
        rover=rover,
        schedule=trace_schedule(scenario.rig),
        rng=stream(seed, "sensor"),
        options=scenario.sensing,
        scenario=scenario,
        path=path,
        rig=nominal_rig(rover),
        build_world=lambda: sand_world(scenario.world, stream(seed, "sand"), rover, terrain, path),
        instruments=ReadOnce(RoverInstruments(rng=stream(seed, "rover instruments"), scale=scale)),
        stream=partial(stream, seed),
    )


def rover_sensing(mount: RoverMountContext) -> RoverSensing:
    """Open the scenario's sensor and slip estimator.

    Raises:
        ValueError: one line, for whatever of the scenario does not fit.
    """
    scenario = mount.scenario
    part: type[SlipEstimator] = resolve("slip_estimator", scenario.slip_estimator, SLIP_ESTIMATOR)
    check_declared("slip_estimator", scenario.slip_estimator, part, ("sensor", "options"))
    opened = opened_rover_sensor(part.sensor if scenario.sensor is None else scenario.sensor, mount)
    context = RoverContext(
        rover=rover_geometry(mount.rover),
        rig=mount.rig,
        rng=mount.stream("slip estimator"),
        options=scenario.estimator,
    )
    return RoverSensing(
        sensor=with_faults(
            opened.sensor,
            [options.fault() for options in scenario.faults],
            camera=mount.rig.camera,
            unit=0,
            rng=lambda k: mount.stream(f"fault {k}"),
        ),
        schedule=opened.schedule,
        estimator=constructed("slip_estimator", scenario.slip_estimator, part, context),
        view=opened.view,
    )


def _driver(scenario: RoverScenario, geometry: RoverGeometry, path: Path) -> RoverDriverLike[Any]:
    part: type[RoverDriverPart[Any]] = resolve("driver", scenario.driver, ROVER_DRIVER)
    context = RoverDriverContext(
        rover=geometry,
        path=path,
        speed=scenario.speed,
        compensation=scenario.slip_compensation,
        options=scenario.driving,
    )
    return CheckedRoverDriver(
        constructed("driver", scenario.driver, part, context), f"driver = {scenario.driver}", len(geometry.places())
    )


def rover_geometry(rover: Rover) -> RoverGeometry:
    """The rover's data sheet for its own odometry and driver."""
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
        ValueError: one line, if the height map is none, or there is one besides slopes that set in.
    """
    heights, everywhere = None, options.slope_from is None
    if options.slope_from is not None:
        if options.height_map:
            raise ValueError("surface.slope_from and surface.height_map: one of them; put the slope into the map")
        heights = _slopes_that_set_in(options, options.slope_from)
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


def _slopes_that_set_in(options: RoverSurfaceOptions, begin: float) -> HeightMap:
    """Level ground that turns into the slopes from x = ``begin`` [m] on, with a slope that is continuous."""
    x = np.arange(begin - _LEVEL, begin + options.slope_over + _SLOPING, _GRID)
    y = np.arange(-_BESIDE, _BESIDE + 0.5 * _GRID, _GRID)
    share = np.clip((x - begin) / options.slope_over, 0.0, 1.0)
    share = share**2 * (3.0 - 2.0 * share)
    along = np.concatenate([[0.0], np.cumsum(0.5 * (share[1:] + share[:-1]) * _GRID)])
    heights = options.grade * along + options.cross_fall * share * y[:, None]
    return HeightMap(heights=heights, spacing=_GRID, x=float(x[0]), y=float(y[0]))


def sand_world(options: SandOptions, rng: np.random.Generator, rover: Rover, terrain: Terrain, path: Path) -> SandWorld:
    """The sand around a path; the generator decides what the options leave open.

    Raises:
        ValueError: one line, if half a sun is given.
    """
    azimuth, elevation = options.sun_azimuth_deg, options.sun_elevation_deg
    if (azimuth is None) != (elevation is None):
        raise ValueError("world.sun_azimuth_deg and world.sun_elevation_deg: give both, or none for the seed's sun")
    sun = None
    if azimuth is not None and elevation is not None:
        sun = Sun(azimuth=math.radians(90.0 - azimuth), elevation=math.radians(elevation))
    route = path.points(_ROUTE)
    return SandWorld(options.terrain, rng=rng, rover=rover, terrain=terrain, route=route, sun=sun)


def trace_schedule(options: TraceRigOptions) -> Schedule:
    """When the camera looks.

    Raises:
        ValueError: one line, if it does not keep time with the loop.
    """
    schedule = Schedule.at_rate(options.rate_hz, latency=options.latency, name="rig.rate_hz")
    for name, ticks in (("1/rig.rate_hz", schedule.period), ("rig.latency", schedule.latency)):
        if ticks % PERIOD:
            raise ValueError(f"{name} = {ticks * TICK:g} s must be a multiple of {PERIOD * TICK:g} s")
    return schedule
