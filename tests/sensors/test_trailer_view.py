"""Frames and signals as one sensor: each at its own rate, and faults of the one do not touch the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.instruments.combination import TrailerViewSensor
from sensors.messages import CombinationSignals, StereoFrame, TrailerView, stereo_frame
from tests.trailers import signals as readings
from vehicle.clock import Schedule

DARK = np.zeros((2, 2), dtype=np.uint8)


@dataclass(frozen=True)
class Moment:
    """All the truth that these sensors need."""

    tick: int


class Camera:
    """Every third frame is lost."""

    def sample(self, truth: Moment) -> StereoFrame | None:
        return None if truth.tick % 300 == 0 else StereoFrame(tick=truth.tick, left=DARK, right=DARK)


class Signals:
    def sample(self, truth: Moment) -> CombinationSignals | None:
        return readings(truth.tick, angles=np.zeros(0), speed=1.0)


def views(latency: int, until: int) -> list[TrailerView]:
    frames, readings = Schedule(period=100, latency=latency), Schedule(period=20, latency=20)
    sensor = TrailerViewSensor(Camera(), frames, Signals(), readings)
    assert (sensor.schedule.period, sensor.schedule.latency) == (20, latency)
    sent = [sensor.sample(Moment(tick)) for tick in range(0, until + 1, sensor.schedule.period)]
    return [view for view in sent if view is not None]


def test_a_view_comes_with_every_due_frame_also_with_a_lost_one() -> None:
    """An estimator cannot bridge an outage that nobody tells it of."""
    sent = views(latency=100, until=1000)
    assert [view.tick for view in sent] == list(range(0, 1001, 100))
    assert [view.frame is None for view in sent] == [tick % 300 == 0 for tick in range(0, 1001, 100)]
    assert stereo_frame(sent[0]) is None
    frame = stereo_frame(sent[1])
    assert frame is not None
    assert frame.tick == 100
    assert stereo_frame(frame) is frame


def test_every_signal_is_sent_once_and_in_order() -> None:
    """Up to the frame's own capture: later ones are not there yet when the view is put together."""
    ticks = [message.tick for view in views(latency=100, until=1000) for message in view.signals]
    assert ticks == list(range(0, 1001, 20))


def test_signals_that_have_not_arrived_are_sent_with_the_next_view() -> None:
    """Frames without latency are older than the signals of the same moment when these arrive."""
    sent = views(latency=0, until=200)
    assert [view.signals[-1].tick for view in sent if view.signals] == [80, 180]
    assert sent[0].signals == ()
