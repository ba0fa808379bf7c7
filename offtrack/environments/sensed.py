"""Camera channels in environments: newest image and estimate, and images reduced to observations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from estimators.context import Estimator
from estimators.estimates import Health
from offtrack.environments.core import Feature, observation_space, within
from scenarios.loop.channel import Channel
from scenarios.loop.timing import Stopwatch
from sensors.messages import GreyImage, Message, Sensor, Stamped, TrailerView
from vehicle.clock import TICK, Schedule
from vehicle.frames import FloatArray

_MIN_SIDE = 8  # an image with fewer pixels to a side shows nothing


class ImageObservation:
    """Observation of reduced images and features: ``{"image": uint8 (n, channels, height, width), "features"}``."""

    def __init__(self, shape: tuple[int, int, int], scale: int, features: tuple[Feature, ...]) -> None:
        """For camera images of this shape (channels, height, width), reduced by a factor.

        Raises:
            ValueError: one line, if the factor does not fit the images.
        """
        self._shape, self._scale = reduced_shape(shape, scale), scale
        self._features = observation_space(features)
        self.space = spaces.Dict({"image": spaces.Box(0, 255, self._shape, np.uint8), "features": self._features})

    def observe(self, features: FloatArray, images: Mapping[int, Sequence[GreyImage]]) -> dict[str, NDArray[Any]]:
        """Observation of n episodes from features (n, n_features) and each episode's channels; black without any."""
        reduced_images = np.zeros((len(features), *self._shape), np.uint8)
        for lane, channels in images.items():
            reduced_images[lane] = [reduced(image, self._scale) for image in channels]
        return {"image": reduced_images, "features": within(features, self._features)}


def reduced_shape(shape: tuple[int, int, int], scale: int) -> tuple[int, int, int]:
    """Channels, height and width of images reduced by a factor.

    Raises:
        ValueError: one line, if the factor is below 1 or leaves too few pixels.
    """
    channels, height, width = shape
    most = min(height, width) // _MIN_SIDE
    if not 1 <= scale <= most:
        raise ValueError(f"image_scale = {scale} must be 1 .. {most} for pictures of {width} x {height}")
    return channels, height // scale, width // scale


def reduced(image: GreyImage, scale: int) -> GreyImage:
    """The image with each square of ``scale`` pixels replaced by its mean; incomplete squares are cut off."""
    if scale == 1:
        return image
    height, width = (side // scale for side in image.shape)
    whole = image[: height * scale, : width * scale]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


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
