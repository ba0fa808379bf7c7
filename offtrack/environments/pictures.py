"""Pictures of episodes for people; camera channels and their images as observations."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any, Final, Generic, TypeVar

import cv2
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.path import Path
from estimators.context import Estimator
from estimators.estimates import Health
from offtrack.environments.core import Feature, observation_space, within
from offtrack.reports import canvas
from offtrack.reports.canvas import ESTIMATED, INK, SOFT, TRUE, Colour, Picture, blank, curve, write
from offtrack.reports.film import draw_flow
from scenarios.courses import Course
from scenarios.loop.channel import Channel, Stopwatch
from scenarios.results.swept_path import UnitOutline, placed, placed_wheels
from scenarios.results.trailer_signals import Estimate
from sensors.messages import GreyImage, Message, Sensor, Stamped, StereoFrame, TrailerView
from vehicle.clock import TICK, Schedule
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray, Pose2
from vehicle.rover.description import Rover
from vehicle.rover.truth import RoverTruth

_SIZE = 600  # [px]
_SCALE = 12.0  # [px/m]: 50 m, three combinations long
_BAY, _MARGIN = 6.0, 0.3  # length of a bay's lines, and its margin to either side [m]
_BACK = 6.0  # from the tractor's rear axle back to the picture's centre [m]


class TopView:
    """Top views of units on their courses."""

    def __init__(self, units: tuple[UnitOutline, ...], courses: Sequence[Course]) -> None:
        """For these outlines; every lane is on the first course until it begins."""
        self._units, self._courses = units, courses
        self._course: dict[int, int] = {}

    def begin(self, lanes: NDArray[np.intp], course: NDArray[np.intp]) -> None:
        """Set the courses of these lanes."""
        self._course.update(zip(lanes.tolist(), course.tolist(), strict=True))

    def picture(
        self,
        lane: int,
        poses: FloatArray,
        steer: tuple[FloatArray, ...],
        caption: str,
        *,
        goal: FloatArray | None = None,
    ) -> Picture:
        """Draw units at poses (N, 3) with their axles' angles [rad], and the last unit's ``goal`` x, y, psi."""
        course = self._courses[self._course.get(lane, 0)]
        picture = blank(_SIZE, _SIZE)
        x, y, psi = poses[0]
        centre = np.array([x - _BACK * np.cos(psi), y - _BACK * np.sin(psi)])
        width = round(2.0 * float(np.max(course.road_half_width)) * _SCALE)
        curve(picture, _pixels(course.centreline, centre), canvas.ROAD, width)
        curve(picture, _pixels(course.path.points(0.5), centre), TRUE, 1)
        for unit, pose, angles in zip(self._units, poses, steer, strict=True):
            body = _pixels(placed(unit.corners, pose[None])[0], centre)
            canvas.vehicle_body(picture, body, _pixels(placed_wheels(unit, pose[None], angles[None])[0], centre))
        if goal is not None:
            half = 0.5 * self._units[-1].width + _MARGIN  # of a bay around the last unit, its end at the goal
            bay = np.array([[_BAY, half], [0.0, half], [0.0, -half], [_BAY, -half]])
            curve(picture, _pixels(placed(bay, goal[None])[0], centre), TRUE, 3)
        write(picture, caption, (12, 10), colour=SOFT)
        return picture


def side_by_side(plan: Picture, view: Picture | None) -> Picture:
    """The top view next to the camera view, if there is one."""
    return plan if view is None else np.concatenate([plan, view], axis=1)


def _pixels(points: FloatArray, centre: FloatArray) -> FloatArray:
    return canvas.seen_from_above(points, centre, _SCALE, 0.5 * _SIZE)


def axle_angles(vehicle: Vehicle, steered: FloatArray) -> tuple[FloatArray, ...]:
    """Angles of each unit's axles [rad] from those of the steered axles, front to rear."""
    angles = iter(steered.tolist())
    return tuple(np.array([next(angles) if axle.steered else 0.0 for axle in unit.axles]) for unit in vehicle.units)


_ROVER_SCALE = 150.0  # [px/m]: 4 m
_SAND = (244, 238, 226)


def rover_picture(rover: Rover, truth: RoverTruth, path: Path, time: float) -> Picture:
    """Draw the rover at this time [s]."""
    picture = blank(_SIZE, _SIZE)
    picture[:] = _SAND
    pose = Pose2(*truth.pose.tolist())
    curve(picture, _rover_pixels(path.points(0.05), pose), TRUE, 2)
    a, b = 0.4 * rover.wheelbase, 0.4 * rover.tread
    body = np.array([[a, b], [a, -b], [-a, -b], [-a, b]])
    canvas.fill(picture, _rover_pixels(pose.apply(body), pose), SOFT)
    tread = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]) * [rover.radius, 0.5 * rover.width]
    for place in rover.wheel_places:
        canvas.fill(picture, _rover_pixels(pose.apply(place + tread), pose), INK)
    write(picture, f"{time:.1f} s, slip angle {math.degrees(truth.slip_angle):+.1f} deg", (12, 10), colour=INK)
    return picture


def _rover_pixels(points: FloatArray, pose: Pose2) -> FloatArray:
    return canvas.seen_from_above(points, np.array([pose.x, pose.y]), _ROVER_SCALE, 0.5 * _SIZE)


WIDTH: Final = 840  # [px]
_HEIGHT: Final = 600  # as the top view
_LINE: Final = 34  # height of a text line [px]
_IMAGE_HEIGHT: Final = (_HEIGHT - 2 * _LINE) // 2  # at most [px]


def stereo_view(frame: StereoFrame, estimate: Estimate | None) -> Picture:
    """Both images, with the newest estimate below."""
    picture = blank(WIDTH, _HEIGHT)
    motion = None if estimate is None else estimate.motion
    tracks: FloatArray = np.empty((0, 4)) if motion is None else motion.tracks.astype(np.float64)
    write(picture, "left camera above, right camera below", (12, 8), colour=SOFT)
    bottom = _LINE + _draw_image(picture, frame.left, tracks, _LINE)
    bottom += _draw_image(picture, frame.right, np.empty((0, 4)), bottom)
    if estimate is not None:
        caption, colour = _caption(estimate)
        write(picture, caption, (12, bottom + 8), colour=colour)
    return picture


def _draw_image(picture: Picture, image: GreyImage, tracks: FloatArray, top: int) -> int:
    """Draw an image; return its height [px]."""
    scale = float(min(WIDTH / image.shape[1], _IMAGE_HEIGHT / image.shape[0]))
    width, height = int(scale * image.shape[1] + 0.5), int(scale * image.shape[0] + 0.5)
    shown = np.asarray(
        cv2.cvtColor(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2RGB), np.uint8
    )
    draw_flow(shown, scale * (tracks + 0.5) - 0.5)
    left = (WIDTH - width) // 2
    picture[top : top + height, left : left + width] = shown
    return height


def _caption(estimate: Estimate) -> tuple[str, Colour]:
    off_tracking = estimate.off_tracking
    if off_tracking.health is Health.LOST:
        return "estimated off-tracking: none", INK
    value, std = off_tracking.value, 1e3 * off_tracking.std
    return f"estimated off-tracking {value:+.3f} m, standard deviation {std:.0f} mm", ESTIMATED


_MIN_SIDE = 8  # an image with fewer pixels to a side shows nothing


class ImageObservation:
    """Observation of reduced images and features: ``{"image": uint8 (n, channels, height, width), "features"}``."""

    def __init__(self, shape: tuple[int, int, int], scale: int, features: tuple[Feature, ...]) -> None:
        """For camera images (channels, height, width), reduced by a factor; incomplete squares of pixels are cut off.

        Raises:
            ValueError: one line, if the factor is below 1 or leaves too few pixels.
        """
        channels, height, width = shape
        most = min(height, width) // _MIN_SIDE
        if not 1 <= scale <= most:
            raise ValueError(f"image_scale = {scale} must be 1 .. {most} for pictures of {width} x {height}")
        self._shape, self._scale = (channels, height // scale, width // scale), scale
        self._features = observation_space(features)
        self.space = spaces.Dict({"image": spaces.Box(0, 255, self._shape, np.uint8), "features": self._features})

    def observe(self, features: FloatArray, images: Mapping[int, Sequence[GreyImage]]) -> dict[str, NDArray[Any]]:
        """Observation of n episodes from features (n, n_features) and each episode's channels; black without any."""
        pixels = np.zeros((len(features), *self._shape), np.uint8)
        _, height, width = self._shape
        for lane, channels in images.items():
            for pixel, image in zip(pixels[lane], channels, strict=True):
                whole = image[: height * self._scale, : width * self._scale]  # each square becomes its mean
                cv2.resize(whole, (width, height), dst=pixel, interpolation=cv2.INTER_AREA)
        return {"image": pixels, "features": within(features, self._features)}


TruthT = TypeVar("TruthT", bound=Stamped)
ImageT = TypeVar("ImageT", bound=Message)
EstimateT = TypeVar("EstimateT")
MemoryT = TypeVar("MemoryT")


class SensedChannel(Generic[TruthT, ImageT, EstimateT]):
    """A channel with the newest of its image messages and of its healthy estimates."""

    def __init__(
        self,
        sensor: Sensor[TruthT, Message],
        schedule: Schedule,
        estimator: Estimator[MemoryT, Message, EstimateT] | None,
        worker: Executor,
        *,
        image_type: type[ImageT],
        health: Callable[[EstimateT], Health],
    ) -> None:
        """Create a channel before its first sample; without an estimator it only captures images."""
        self.schedule = schedule
        self.image: ImageT | None = None  # the newest
        self.healthy: EstimateT | None = None  # the newest estimate with health
        self._image_type, self._health = image_type, health
        self._channel: Channel[TruthT, Message, EstimateT] = Channel(sensor, schedule, estimator, worker, Stopwatch())

    @property
    def newest(self) -> EstimateT | None:
        """The estimate delivered last."""
        return self._channel.newest

    @property
    def usable(self) -> bool:
        """True if the estimate delivered last has health."""
        return self.newest is not None and self._health(self.newest) is not Health.LOST

    def look(self, truth: TruthT) -> None:
        """Sample the sensor if it is due, and receive the estimates that are due."""
        message = self._channel.sample(truth, truth.tick)
        image = message.frame if isinstance(message, TrailerView) else message
        if isinstance(image, self._image_type):
            self.image = image
        known = len(self._channel.delivered)
        self._channel.deliver(truth.tick)
        for estimate in self._channel.delivered[known:]:
            if self._health(estimate) is not Health.LOST:
                self.healthy = estimate

    def image_age(self, tick: int, *, without: float) -> float:
        """Age of the newest image [s]; ``without`` an image, this value."""
        return without if self.image is None else (tick - self.image.tick) * TICK
