"""A channel of the loop as environments read it: its newest images and its newest estimate with health."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from typing import Generic, TypeVar

from estimators.estimates import Health
from estimators.protocol import Estimator
from scenarios.loop.channel import Channel
from scenarios.loop.stopwatch import Stopwatch
from sensors.messages import TrailerView
from sensors.sensor import Message, Sensor, Stamped
from vehicle.clock import TICK, Schedule

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
