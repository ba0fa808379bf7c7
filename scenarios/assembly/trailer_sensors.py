"""Sensors mounted on a trailer: their context, the rendered world, and cameras with their calibration from boards.

A board is held all over the view of both cameras: its pictures give the lenses and the pose between the cameras. Other
boards stand at surveyed positions: they give the cameras' pose on the trailer, which also compensates the rotation of
the view by errors of the principal points. The mount is straight during the calibration and bends only later.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Final, Generic, NamedTuple, TypeVar

import cv2
import numpy as np
import scipy

import sensors.camera
from controllers.trailer import TrailerGeometry
from estimators.calibration.boards import BoardView, board_view, calibrated, calibrated_pair, in_same_order
from estimators.calibration.rectification import Rectifier
from estimators.context import Estimator
from estimators.rigid_motion import rotation_vector
from scenarios.assembly.adapters import rig_on
from scenarios.courses import Course
from scenarios.options.tables import GroundRigOptions, RigOptions, SurfaceOptions, TrafficOptions, WorldOptions
from scenarios.progress import Progress, no_progress
from sensors.camera.calibration_target import Checkerboard, board_image, random_board_pose
from sensors.camera.image_formation import AutoExposure
from sensors.camera.rig import (
    UNDISTORTED,
    CameraModel,
    RawStereoRig,
    StereoCalibration,
    ground_watching_pair,
    mount_rotation,
)
from sensors.camera.stereo_camera import Imperfections, PairSource, RawStereoCamera, StereoCamera, pinholes_for
from sensors.context import TrailerSensorContext
from sensors.instruments.combination import CombinationSensors
from sensors.instruments.navigation import ExactPose
from sensors.messages import Message, Sensor, StereoFrame, TrailerView
from sensors.render import StereoRenderer
from sensors.world.ground import ground_height
from sensors.world.traffic import InTraffic, StereoSampler, Traffic, populated
from sensors.world.world import ReformedGround, World, build_world
from vehicle.clock import Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.combination.unit import Unit
from vehicle.engine.function_cache import SOURCES
from vehicle.foundation.own_parts import close_part
from vehicle.foundation.user_cache import made_once, sources_hash
from vehicle.frames import FloatArray, inverse, so3_exp, transform
from vehicle.surface import Surface

# Of all code that makes a world, while it is imported.
_SOURCES: Final = " ".join(
    [SOURCES, sources_hash(Path(sensors.camera.__file__).parents[1]), scipy.__version__, cv2.__version__]
)
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
    """The world around a course, from the user's cache if it has been there before."""
    azimuth, elevation = options.sun_azimuth_deg, options.sun_elevation_deg
    half_width = course.road_half_width if course.paved is None else course.paved
    if options.tarmac_width is not None:
        half_width = 0.5 * options.tarmac_width
    return made_once(
        build_world,
        _SOURCES,
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


_BOARD: Final = Checkerboard(columns=11, rows=8, square=0.1)  # assumed: 1.4 m by 1.1 m, the largest for two people
_OUTERMOST: Final = [0, _BOARD.columns - 1, -_BOARD.columns, -1]  # of its corners
_HELD: Final = 30  # number of image pairs of the held board
_SURVEYED: Final = 12  # number of left images of surveyed boards
_COLUMNS: Final = 6  # strips of the image, used in turn: random positions would leave its sides nearly empty
_HELD_SQUARE: Final = (40.0, 12.0)  # side of a square in the image, nearest and farthest [px]
_SURVEYED_SQUARE: Final = (19.0, 9.0)  # the same of surveyed boards: distance separates rotation from translation
_NEAREST: Final = 0.5  # smallest depth of any corner [m]
_TILT = (0.2, 0.8)  # range of angles from frontal [rad]
_EDGE = 8.0  # smallest distance of a corner from the edge of the image [px]
_TRIES = 1_000  # largest number of tries for a pose that both cameras see; one in five succeeds


class BoardCalibration(NamedTuple):
    """A calibrated rig with the residuals of the fit."""

    rig: RawStereoRig
    rms: float  # RMS reprojection error of corners [px]
    rotation_std: float  # standard deviation of each angle between the cameras [rad]


def calibrated_with_boards(
    true: RawStereoRig, *, noise_std: float, rng: np.random.Generator, progress: Progress = no_progress
) -> BoardCalibration:
    """Calibrate a rig from rendered pictures of boards.

    Args:
        true: the rig that takes the pictures.
        noise_std: image noise [grey levels].
        rng: determines the poses of the boards, and the noise.
        progress: receives the number of finished pictures, and their total.

    Raises:
        ValueError: if the boards do not fit into the view of both cameras, or the calibration fails.
    """
    poses = [
        _board_pose(true, k % _COLUMNS, _HELD_SQUARE if k < _HELD else _SURVEYED_SQUARE, rng)
        for k in range(_HELD + _SURVEYED)
    ]
    left: list[BoardView] = []
    right: list[BoardView] = []
    for k, X_ClB in enumerate(poses):
        left.append(_picture(k, true.left, X_ClB, noise_std, rng))
        if k < _HELD:
            right.append(_picture(k, true.right, inverse(true.X_ClCr) @ X_ClB, noise_std, rng))
        progress(k + 1, len(poses))
    held_left, surveyed = left[:_HELD], left[_HELD:]
    fit = calibrated_pair(held_left, right, (calibrated(held_left, _BOARD), calibrated(right, _BOARD)), _BOARD)
    X_SC = _mounted(fit.left, surveyed, [true.X_SC @ X_ClB for X_ClB in poses[_HELD:]], true.X_SC)
    rig = RawStereoRig(left=fit.left, right=fit.right, X_ClCr=fit.X_ClCr, X_SC=X_SC)
    return BoardCalibration(rig, fit.rms, fit.rotation_std)


def _picture(k: int, camera: CameraModel, X_CB: FloatArray, noise_std: float, rng: np.random.Generator) -> BoardView:
    image = board_image(_BOARD, camera, X_CB, noise_std=noise_std, rng=rng)
    return board_view(f"board {k + 1}", image, _BOARD)


def _board_pose(rig: RawStereoRig, column: int, squares: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """X_ClB (4, 4) of a board that both cameras see completely, with its centre in one strip of the left image.

    ``squares`` is the side of its squares in the middle of the image, nearest and farthest [px].
    """
    nearest, farthest = (rig.left.fx * _BOARD.square / px for px in squares)
    width, height = rig.left.width, rig.left.height
    for _ in range(_TRIES):
        depth, at = rng.uniform(nearest, farthest), rng.uniform([column, 0.0], [column + 1.0, 1.0])
        ray = rig.left.rays(at * [width / _COLUMNS, height])
        X_ClB = random_board_pose(_BOARD, rng, ray=ray, depth=depth, tilt=rng.uniform(*_TILT))
        if _shows(rig.left, X_ClB) and _shows(rig.right, inverse(rig.X_ClCr) @ X_ClB):
            return X_ClB
    raise ValueError(
        f"rig.calibration = boards: no position found where both cameras see all of a board of {_BOARD.columns}x"
        f"{_BOARD.rows} corners; the baseline of {rig.baseline:g} m is too long or the view too narrow: use exact"
    )


def _shows(camera: CameraModel, X_CB: FloatArray) -> bool:
    """True if all corners of the board are in the image."""
    p = _BOARD.corners[_OUTERMOST] @ X_CB[:3, :3].T + X_CB[:3, 3]
    if p[:, 2].min() < _NEAREST:
        return False
    pixels = camera.project(p)
    size = np.array([camera.width, camera.height])
    return bool(((pixels > _EDGE) & (pixels < size - 1.0 - _EDGE)).all())


def _mounted(
    camera: CameraModel, views: Sequence[BoardView], surveyed: Sequence[FloatArray], designed: FloatArray
) -> FloatArray:
    """X_SC (4, 4) of a camera from pictures of boards at known poses X_SB: the pose that fits all corners best.

    The ``designed`` pose resolves the orientation of a board in the image, and starts the search.
    """
    lens, X_CS = (camera.matrix, np.array(camera.distortion)), inverse(designed)
    points, corners = [], []
    for view, X_SB in zip(views, surveyed, strict=True):
        if view.corners is not None:
            on_board = _BOARD.corners @ X_SB[:3, :3].T + X_SB[:3, 3]
            expected = camera.project(on_board @ X_CS[:3, :3].T + X_CS[:3, 3]).astype(np.float32)
            points.append(on_board)
            corners.append(in_same_order(expected, view.corners).astype(np.float64))
    if not points:
        raise ValueError("rig.calibration = boards: no surveyed board was detected in its image")
    _, turn, p = cv2.solvePnP(
        np.concatenate(points),
        np.concatenate(corners),
        *lens,
        rotation_vector(X_CS[:3, :3])[:, None],
        X_CS[:3, 3:].copy(),
        useExtrinsicGuess=True,
    )
    R_CS = so3_exp(np.asarray(turn, dtype=np.float64).ravel())
    return inverse(transform(R_CS, np.asarray(p, dtype=np.float64).ravel()))


MemoryT = TypeVar("MemoryT")
EstimateT = TypeVar("EstimateT")


class Rectified(Generic[MemoryT, EstimateT]):
    """An estimator that receives raw stereo frames rectified."""

    def __init__(
        self, estimator: Estimator[MemoryT, StereoFrame | TrailerView, EstimateT], rectifier: Rectifier
    ) -> None:
        self._estimator, self._rectifier = estimator, rectifier

    def init(self) -> MemoryT:
        """Memory before the first frame."""
        return self._estimator.init()

    def step(self, memory: MemoryT, message: StereoFrame | TrailerView) -> tuple[MemoryT, EstimateT | None]:
        """Step of the estimator with the rectified frame."""
        if isinstance(message, StereoFrame):
            return self._estimator.step(memory, self._rectifier.step(message))
        if message.frame is not None:
            message = replace(message, frame=self._rectifier.step(message.frame))
        return self._estimator.step(memory, message)

    def close(self) -> None:
        """Close the estimator."""
        close_part(self._estimator)


class StereoCameras:
    """The scenario's stereo cameras: ideal pinholes, or cameras with the imperfections of the options.

    The calibration includes the lenses but not the later bending of the mount.
    """

    sends: ClassVar = StereoFrame

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """Cameras on one trailer.

        Raises:
            ValueError: if the lenses are not possible or cannot be calibrated.
            RendererUnavailableError: if OpenGL does not work here.
        """
        options, views = context.rig, context.views
        rig = rig_on(context.vehicle.units[context.unit], context.trailer, options)
        noise = context.stream("camera noise")
        imperfections = _imperfections(options)
        straight, exact = not any(options.misrotation_deg), options.calibration == "exact"
        undistorted = options.distortion == UNDISTORTED
        if straight and exact and undistorted and replace(imperfections, read_noise=0.0) == Imperfections():
            return _pinholes(context, rig.calibration(), noise)
        true = rig.raw(options.distortion, mount_rotation(*np.radians(options.misrotation_deg)))
        calibrated = rig.raw(options.distortion)
        if not exact:
            board_noise = math.hypot(options.noise, math.sqrt(0.5) * options.shot_noise)  # half of a board is white
            boards = context.stream("calibration boards")
            calibrated = calibrated_with_boards(
                calibrated, noise_std=board_noise, rng=boards, progress=context.progress
            ).rig
        rectifier = None if exact and undistorted else Rectifier(calibrated)
        renderer, light = views.seen_by(pinholes_for(true, imperfections)), views.world.light
        camera = RawStereoCamera(
            renderer=renderer,
            rig=true,
            imperfections=imperfections,
            sun=None if light.overcast else light.direction,
            unit=context.unit,
            rng=noise,
            keep_colour=context.keep_colour,
        )
        cameras = Cameras(
            calibrated=calibrated if rectifier else rig.calibration(),
            calibration=rectifier.calibration if rectifier else rig.calibration(),
            rectifier=rectifier,
        )
        return OpenedSensor(sensor=views.amid(camera, renderer), schedule=context.schedule, cameras=cameras)


def _pinholes(context: MountContext, calibration: StereoCalibration, noise: np.random.Generator) -> OpenedSensor:
    renderer = context.views.seen_by(calibration)
    camera = StereoCamera(
        renderer=renderer, unit=context.unit, noise_std=context.rig.noise, rng=noise, keep_colour=context.keep_colour
    )
    return OpenedSensor(
        sensor=context.views.amid(camera, renderer),
        schedule=context.schedule,
        cameras=Cameras(calibrated=calibration, calibration=calibration),
    )


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


class GroundCameras:
    """Two cameras under a trailer that look straight down; its wheels may re-form the ground."""

    sends: ClassVar = StereoFrame

    @classmethod
    def of(cls, context: MountContext) -> OpenedSensor:
        """Cameras under one trailer.

        Raises:
            ValueError: if the rear camera would not be behind the front one.
            RendererUnavailableError: if OpenGL does not work here.
        """
        options, ground = context.ground_rig, context.ground
        calibration = ground_watching_pair(
            options.width,
            options.height,
            math.radians(options.hfov_deg),
            front_x=-options.front,
            rear_x=options.rear - context.trailer.follow_distance,
            z=options.camera_height,
        )
        renderer = context.views.seen_by(calibration)
        source: PairSource = renderer
        if ground.reformed_width > 0.0:
            wheels, width = wheels_near(context.vehicle, context.unit), ground.reformed_width
            source = ReformedGround(renderer, context.surface, wheels, width=width, flow=ground.reformed_flow)
        camera = StereoCamera(
            renderer=source,
            unit=context.unit,
            noise_std=context.rig.noise,
            rng=context.stream("camera noise"),
            keep_colour=context.keep_colour,
        )
        cameras = Cameras(calibrated=calibration, calibration=calibration, epipolar=False)
        return OpenedSensor(sensor=camera, schedule=context.schedule, cameras=cameras)


def wheels_near(vehicle: Vehicle, unit: int) -> tuple[FloatArray, FloatArray]:
    """Positions of wheels in the unit's frame, (n, 2) [m] each: the rearmost of the unit ahead, and its own.

    The former are close to the hitch, so that the articulation hardly moves them.
    """
    own, leader = vehicle.units[unit], vehicle.units[unit - 1]
    last = min(leader.axles, key=lambda axle: axle.x)
    ahead = 0.0 if leader.hitch_x is None else last.x - leader.hitch_x
    return _both_sides([(ahead, last.track)]), _both_sides([(axle.x, axle.track) for axle in own.axles])


def _both_sides(axles: list[tuple[float, float]]) -> FloatArray:
    return np.array([(x, side * 0.5 * track) for x, track in axles for side in (1.0, -1.0)])
