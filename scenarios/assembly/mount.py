"""The rendered world of a run, and the sensors mounted on its trailers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controllers.trailer import TrailerGeometry
from estimators.calibration.rectification import Rectifier
from scenarios.courses import Course
from scenarios.options.perception import GroundRigOptions, RigOptions, WorldOptions
from scenarios.options.surroundings import SurfaceOptions, TrafficOptions
from scenarios.progress import Progress, no_progress
from sensors.camera.lens import RawStereoRig
from sensors.camera.rig import StereoCalibration
from sensors.context import TrailerSensorContext
from sensors.instruments.combination import CombinationSensors
from sensors.instruments.navigation import ExactPose
from sensors.messages import Message, Sensor, StereoFrame
from sensors.render import StereoRenderer
from sensors.world.ground import ground_height
from sensors.world.traffic import InTraffic, StereoSampler, Traffic, populated
from sensors.world.world import World, build_world
from vehicle.clock import Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.combination.unit import Unit
from vehicle.surface import Surface

_SCENERY_CLEARANCE = 8.0  # distance of scenery from the course; trailers cut in by several metres [m]


class Views:
    """One world and one renderer for the cameras of all trailers, built when the first is opened."""

    def __init__(self, built: Callable[[], World], traffic: Traffic | None = None) -> None:
        self._built = built
        self._traffic = traffic
        self._world: World | None = None
        self._renderer: StereoRenderer | None = None

    @property
    def world(self) -> World:
        """The world of the run."""
        if self._world is None:
            self._world = self._built() if self._traffic is None else populated(self._built(), self._traffic)
        return self._world

    def amid(self, camera: StereoSampler, renderer: StereoRenderer) -> StereoSampler:
        """The camera, with moving traffic in its view if there is any."""
        return camera if self._traffic is None else InTraffic(camera, renderer, self._traffic)

    def seen_by(self, calibration: StereoCalibration) -> StereoRenderer:
        """A renderer for the cameras of this calibration; the first one owns OpenGL's context.

        Raises:
            RendererUnavailableError: if OpenGL does not work here.
        """
        if self._renderer is None:
            self._renderer = StereoRenderer(self.world, calibration)
            return self._renderer
        return self._renderer.on(calibration)

    @property
    def renderer_name(self) -> str:
        """Name of OpenGL's renderer; "none" if nothing was rendered."""
        return "none" if self._renderer is None else self._renderer.name

    def close(self) -> None:
        """Close the renderer."""
        if self._renderer is not None:
            self._renderer.close()


def traffic_around(
    options: TrafficOptions, trailer: Unit, geometry: TrailerGeometry, surface: Surface, rng: np.random.Generator
) -> Traffic | None:
    """The traffic around a combination whose last unit is the ``trailer``; None if there is none."""
    if options.kind == "none":
        return None
    return Traffic(
        rng,
        kind=options.kind,
        gap=options.gap,
        follow_distance=geometry.follow_distance,
        half_width=0.5 * trailer.width,
        height=lambda xy: ground_height(surface, xy),
    )


def built_world(options: WorldOptions, course: Course, surface: Surface, rng: np.random.Generator) -> World:
    """The world around a course."""
    azimuth, elevation = options.sun_azimuth_deg, options.sun_elevation_deg
    half_width = course.road_half_width if options.tarmac_width is None else 0.5 * options.tarmac_width
    return build_world(
        rng=rng,
        centreline=course.centreline,
        road_half_width=half_width,
        lane_lines=course.lane_lines if options.tarmac_width is None else None,
        surface=surface,
        scenery_density=options.scenery_density,
        clearance=max(_SCENERY_CLEARANCE, float(np.max(half_width))),
        sun_azimuth=None if azimuth is None else math.radians(azimuth),
        sun_elevation=None if elevation is None else math.radians(elevation),
        overcast=options.overcast,
        grain=options.grain,
        tarmac_patches=options.tarmac_patches,
    )


# assumed: gyros and angle sensors send every 20 ms; processing a message takes as long
SIGNALS = Schedule.at_rate(50.0, latency=0.02)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountContext(TrailerSensorContext):
    """Context of the built-in sensors, with the options that they read."""

    views: Views
    nominal: Vehicle  # the data sheet of controllers and estimators
    rig: RigOptions
    ground_rig: GroundRigOptions
    ground: SurfaceOptions  # under the wheels: it may be re-formed by them
    trailer: TrailerGeometry
    signals: CombinationSensors  # of this trailer
    stream: Callable[[str], np.random.Generator]  # random stream of this trailer, by name
    keep_colour: bool = False  # frames carry the left camera's colour image
    progress: Progress = no_progress  # of a calibration with boards


@dataclass(frozen=True, slots=True, kw_only=True)
class Cameras:
    """Calibrations of a stereo pair."""

    calibrated: StereoCalibration | RawStereoRig  # of the images as sent
    calibration: StereoCalibration  # of the images that estimators receive
    rectifier: Rectifier | None = None  # from the former to the latter; None: they are equal
    epipolar: bool = True  # the optical axes are parallel, as a stereo odometry needs

    def rectified(self, frame: StereoFrame) -> StereoFrame:
        """The frame as estimators receive it."""
        return frame if self.rectifier is None else self.rectifier.step(frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenedSensor:
    """A sensor that is ready to sample."""

    sensor: Sensor[Truth, Message]
    schedule: Schedule
    cameras: Cameras | None = None  # None: not a stereo pair


class ReferencePose:
    """Exact plan poses of the trailer, at the rate of the cameras."""

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """Reference unit on the trailer."""
        height = context.nominal.units[context.unit].roll_axis_height
        return OpenedSensor(sensor=ExactPose(context.unit, height), schedule=context.schedule)


class SignalsOfCombination:
    """The combination's own sensors at 50 Hz: speed, steer and articulation angles, gyros."""

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """Sensors of the combination, shared with the trailer's steering law."""
        return OpenedSensor(sensor=context.signals, schedule=SIGNALS)
