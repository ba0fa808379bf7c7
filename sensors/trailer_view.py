"""A stereo camera and the signals of the combination as one sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Generic, TypeVar

from sensors.messages import CombinationSignals, StereoFrame, TrailerView
from sensors.sensor import Sensor, Stamped
from vehicle.clock import Schedule

TruthT = TypeVar("TruthT", bound=Stamped)


class TrailerViewSensor(Generic[TruthT]):
    """A stereo camera with the signals that arrive until its frame has been processed.

    Signals are collected at their own rate. A view is sent whenever a frame is due, also if none arrives: faults of the
    camera do not touch the signals.
    """

    def __init__(
        self,
        camera: Sensor[TruthT, StereoFrame],
        frames: Schedule,
        signals: Sensor[TruthT, CombinationSignals],
        readings: Schedule,
    ) -> None:
        """For a ``camera`` on the schedule ``frames``, and ``signals`` on the schedule ``readings``.

        ``schedule`` is that of the sensor: sample it whenever one of the two is due.
        """
        self._camera, self._frames = camera, frames
        self._signals, self._readings = signals, readings
        period = math.gcd(frames.period, frames.offset, readings.period, readings.offset)
        self.schedule = Schedule(period=period, latency=frames.latency)
        self._waiting: tuple[CombinationSignals, ...] = ()

    def sample(self, truth: TruthT) -> TrailerView | None:
        """View at this tick; None if no frame is due."""
        rest = self.begin(truth)
        return None if rest is None else rest()

    def begin(self, truth: TruthT) -> Callable[[], TrailerView] | None:
        """Collect the signals of this tick; the returned function takes the frame, also in another thread.

        None if no frame is due.
        """
        if self._readings.due(truth.tick):
            reading = self._signals.sample(truth)
            self._waiting += () if reading is None else (reading,)
        if not self._frames.due(truth.tick):
            return None
        known = truth.tick + self._frames.latency - self._readings.latency  # newest reading when the frame is processed
        arrived = tuple(reading for reading in self._waiting if reading.tick <= known)
        self._waiting = self._waiting[len(arrived) :]
        return lambda: TrailerView(tick=truth.tick, frame=self._camera.sample(truth), signals=arrived)
