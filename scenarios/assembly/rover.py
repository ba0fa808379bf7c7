"""From a rover's scenario to the parts of its run: constructed, and refused if need be, before anything moves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from controllers.path import Path
from controllers.rover_driver import RoverDriver
from estimators.context import RoverContext, SlipEstimator
from estimators.slip.rover_odometry import RoverGeometry
from scenarios.assembly.rover_courses import rover_path
from scenarios.catalogue import SLIP_ESTIMATOR, resolve
from scenarios.options.rover import RoverScenario, RoverSurfaceOptions, SandOptions, TraceRigOptions
from scenarios.randomness import stream
from sensors.instruments.rover_navigation import LaserTracker, RoverInstruments
from sensors.sand.rig import nominal_rig
from sensors.sand.trace_camera import TraceCamera, Webcam
from sensors.sand.trace_rig import TraceRig
from sensors.sand.world import SandWorld, Sun
from vehicle.clock import TICK, Schedule
from vehicle.rover.description import Rover, load_rover
from vehicle.rover.height_map import HeightMap, load_height_map
from vehicle.rover.plant import RoverPlant
from vehicle.rover.soil import load_soil
from vehicle.rover.terrain import Mound, Terrain

PERIOD = 50  # of control and log, and how far the plant is integrated in one call [ticks]
_GRID, _LEVEL, _SLOPING, _BESIDE = 0.1, 1.0, 20.0, 20.0  # of ground whose slopes set in: its mesh and extent [m]
_ROUTE = 0.1  # between points of the way that the ground is laid out along [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverAssembly:
    """The parts of one run."""

    scenario: RoverScenario
    seed: int
    rover: Rover
    geometry: RoverGeometry
    path: Path
    plant: RoverPlant
    driver: RoverDriver
    schedule: Schedule  # of the camera, or of an exact instrument in its place
    instruments: RoverInstruments
    laser: LaserTracker
    source: SlipEstimator
    rig: TraceRig
    world: SandWorld | None  # None: nothing is looked at
    camera: TraceCamera | None


def assemble_rover(scenario: RoverScenario, seed: int, *, record: bool = False) -> RoverAssembly:
    """The parts of the scenario's run with this seed; ``record``: have a camera even if the slip is known without.

    Raises:
        ValueError: one line, for whatever of the scenario does not fit.
    """
    rover = load_rover(scenario.vehicle)
    geometry = rover_geometry(rover)
    path = rover_path(scenario.course)
    options = scenario.surface
    terrain = terrain_of(options)
    soil = None if options.soil == "none" else load_soil(options.soil)
    driver = RoverDriver(geometry, path, scenario.speed, compensation=scenario.slip_compensation)
    estimator: type[SlipEstimator] = resolve("slip_estimator", scenario.slip_estimator, SLIP_ESTIMATOR)
    sees = estimator.sensor == "trace_camera"
    if sees and soil is None:
        raise ValueError(
            f"slip_estimator = {scenario.slip_estimator}: hard ground (surface.soil = none) takes no trace"
        )
    rig = nominal_rig(rover)
    world = sand_world(scenario.world, stream(seed, "sand"), rover, terrain, path) if sees or record else None
    return RoverAssembly(
        scenario=scenario,
        seed=seed,
        rover=rover,
        geometry=geometry,
        path=path,
        plant=RoverPlant(rover, terrain, soil),
        driver=driver,
        schedule=trace_schedule(scenario.rig),
        instruments=RoverInstruments(rng=stream(seed, "rover instruments"), scale=scenario.signals.noise),
        laser=LaserTracker(rng=stream(seed, "laser tracker"), scale=scenario.signals.noise),
        source=estimator.of(RoverContext(rover=geometry, rig=rig, rng=stream(seed, "slip estimator"), options={})),
        rig=rig,
        world=world,
        camera=trace_camera(world, rig, scenario.rig, stream(seed, "camera noise")) if world else None,
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


def trace_camera(world: SandWorld, rig: TraceRig, options: TraceRigOptions, rng: np.random.Generator) -> TraceCamera:
    """The camera of a rig, with the noise that the options say."""
    return TraceCamera(world, rig, Webcam(read_noise=options.noise, shot_noise=options.shot_noise), rng)


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
