"""The stereo cameras of a run: the world they see, the renderer, and what their images need before they are used."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.trailer import TrailerGeometry
from estimators.calibration.rectification import Rectifier
from scenarios.assembly.board_calibration import Told, calibrated_with_boards
from scenarios.assembly.courses import Course
from scenarios.options.rig import RigOptions, WorldOptions
from scenarios.options.traffic import TrafficOptions
from sensors.camera.exposure import AutoExposure
from sensors.camera.lens import UNDISTORTED, RawStereoRig, mount_rotation
from sensors.camera.raw_camera import Imperfections, RawStereoCamera, pinholes_for
from sensors.camera.rig import StereoCalibration, StereoRig
from sensors.camera.stereo_camera import StereoCamera
from sensors.messages import StereoFrame
from sensors.render import StereoRenderer
from sensors.world.ground import ground_height
from sensors.world.traffic import InTraffic, Sampled, Traffic, populated
from sensors.world.world import World, build_world
from vehicle.combination.description import Unit
from vehicle.surface import Surface

_SCENERY_CLEARANCE = 8.0  # trailers cut in by several metres, and nothing solid may stand there [m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cameras:
    """The stereo cameras with the renderer behind them, which has to be closed in the end."""

    calibrated: StereoCalibration | RawStereoRig  # what a calibration says of the images that are sent
    calibration: StereoCalibration  # of the images that estimators work on
    camera: Sampled
    renderer: StereoRenderer
    rectifier: Rectifier | None  # None: images are worked on as they are sent

    def rectified(self, frame: StereoFrame) -> StereoFrame:
        """The frame as estimators work on it."""
        return frame if self.rectifier is None else self.rectifier.step(frame)


class Views:
    """What the cameras of all trailers see: one world and one renderer, built when the first of them is opened."""

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

    def amid(self, camera: Sampled, renderer: StereoRenderer) -> Sampled:
        """A camera that sees the traffic where it is, if there is any."""
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


class Rectified:
    """An off-tracking source that gets rectified frames of raw ones."""

    def __init__(self, source: Any, rectifier: Rectifier) -> None:
        self._source, self._rectifier = source, rectifier

    def init(self) -> Any:
        """The source's memory before any frame."""
        return self._source.init()

    def step(self, memory: Any, message: StereoFrame) -> tuple[Any, Any]:
        """The source's step with the rectified frame."""
        stepped: tuple[Any, Any] = self._source.step(memory, self._rectifier.step(message))
        return stepped


def built_world(options: WorldOptions, course: Course, surface: Surface, rng: np.random.Generator) -> World:
    """The world around a course."""
    azimuth, elevation = options.sun_azimuth_deg, options.sun_elevation_deg
    half_width = course.road_half_width if options.tarmac_width is None else 0.5 * options.tarmac_width
    return build_world(
        rng=rng,
        centreline=course.centreline,
        road_half_width=half_width,
        surface=surface,
        scenery_density=options.scenery_density,
        clearance=max(_SCENERY_CLEARANCE, half_width),
        sun_azimuth=None if azimuth is None else math.radians(azimuth),
        sun_elevation=None if elevation is None else math.radians(elevation),
        overcast=options.overcast,
        grain=options.grain,
        tarmac_patches=options.tarmac_patches,
    )


def opened_cameras(
    options: RigOptions,
    rig: StereoRig,
    views: Views,
    *,
    unit: int,
    rng: np.random.Generator,
    boards: np.random.Generator,
    keep_colour: bool,
    calibrating: Told | None = None,
) -> Cameras:
    """The cameras on a unit of the vehicle: pinholes exactly where they should be, or what the options make of them.

    The calibration knows of the lenses, but not of how the mount is bent: as if it had been made before.

    Args:
        options: what the cameras are like.
        rig: where they should be.
        views: what they see.
        unit: that carries them.
        rng: decides their noise.
        boards: decides what they are calibrated with, if with boards.
        keep_colour: let frames carry what the left camera saw in colour.
        calibrating: told how many pictures of boards are done, of how many.

    Raises:
        ValueError: if the lenses can not be, or can not be calibrated.
        RendererUnavailableError: if OpenGL does not work here.
    """
    how = _imperfections(options)
    straight = not any(options.misrotation_deg)
    known = options.calibration == "exact"
    if straight and known and options.distortion == UNDISTORTED and replace(how, read_noise=0.0) == Imperfections():
        return _pinholes(rig.calibration(), views, unit=unit, noise=options.noise, rng=rng, keep_colour=keep_colour)
    true = rig.raw(options.distortion, mount_rotation(*np.radians(options.misrotation_deg)))
    calibrated = rig.raw(options.distortion)
    if not known:
        noise = math.hypot(options.noise, math.sqrt(0.5) * options.shot_noise)  # of a board, half of it white
        calibrated = calibrated_with_boards(calibrated, noise_std=noise, rng=boards, told=calibrating).rig
    rectifier = None if known and options.distortion == UNDISTORTED else Rectifier(calibrated)
    renderer, light = views.seen_by(pinholes_for(true, how)), views.world.light
    camera = RawStereoCamera(
        renderer=renderer,
        rig=true,
        imperfections=how,
        sun=None if light.overcast else light.direction,
        unit=unit,
        rng=rng,
        keep_colour=keep_colour,
    )
    return Cameras(
        calibrated=calibrated if rectifier else rig.calibration(),
        calibration=rectifier.calibration if rectifier else rig.calibration(),
        camera=views.amid(camera, renderer),
        renderer=renderer,
        rectifier=rectifier,
    )


def _pinholes(
    calibration: StereoCalibration,
    views: Views,
    *,
    unit: int,
    noise: float,
    rng: np.random.Generator,
    keep_colour: bool,
) -> Cameras:
    renderer = views.seen_by(calibration)
    camera = StereoCamera(renderer=renderer, unit=unit, noise_std=noise, rng=rng, keep_colour=keep_colour)
    seeing = views.amid(camera, renderer)
    return Cameras(calibrated=calibration, calibration=calibration, camera=seeing, renderer=renderer, rectifier=None)


def _imperfections(options: RigOptions) -> Imperfections:
    roll, yaw, pitch = (math.radians(angle) for angle in options.twist_deg)
    automatic = AutoExposure(time_constant=options.exposure_time_constant)
    return Imperfections(
        twist=(roll, yaw, pitch),
        read_noise=options.noise,
        shot_noise=options.shot_noise,
        exposure_time=1e-3 * options.exposure_time_ms,
        rolling_shutter=1e-3 * options.rolling_shutter_ms,
        auto_exposure=automatic if options.exposure == "auto" else None,
        vignetting=options.vignetting,
        dirt=options.dirt,
        rain=options.rain,
        glare=options.glare,
    )
