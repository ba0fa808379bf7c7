"""One trailer of a running loop: what is under way to its estimate, the newest of these, and what its law makes of it.

What an estimator makes of a message depends on nothing but the messages before it, so it is worked out beside the loop,
in one thread for all trailers, between the message's capture and its delivery: the second core would idle otherwise.
The results are the same to the bit.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager
from typing import Literal

import numpy as np

from controllers.trailer import SteerCommand
from estimators.estimates import CameraOffTracking, OffTracking
from scenarios.assembly.sensing import Message
from scenarios.assembly.trailer import WatchedTrailer
from scenarios.results.trailer_signals import Estimate
from vehicle.clock import Pipe
from vehicle.combination.truth import Truth

Timed = Callable[[Literal["odometry", "wait"]], AbstractContextManager[None]]


class TrailerLoop:
    """The loop around one trailer."""

    def __init__(self, watched: WatchedTrailer, worker: Executor, timed: Timed) -> None:
        """Before the first tick; ``timed`` keeps account of the seconds that estimating takes."""
        self.watched = watched
        self.estimates: list[Estimate] = []  # those delivered
        self.demand = SteerCommand(angles=np.zeros(watched.n_steered))
        self._worker, self._timed = worker, timed
        self._in_flight: Pipe[Future[Estimate | None]] = Pipe()
        self._newest: OffTracking | None = None
        self._source, self._law = watched.sensing.source.init(), watched.law.init()

    @property
    def law_memory(self) -> object:
        """What the steering law carries from one step to the next."""
        return self._law

    def send(self, message: Message, tick: int) -> None:
        """Hands a message to the estimator, whose answer arrives a latency later."""
        answer = self._worker.submit(self._estimate, message)
        self._in_flight = self._in_flight.put(tick + self.watched.sensing.schedule.latency, answer)

    def deliver(self, tick: int) -> None:
        """Takes what has arrived by now."""
        self._in_flight, due = self._in_flight.deliver(tick)
        for future in due:
            with self._timed("wait"):
                estimate = future.result()
            if estimate is not None:
                self.estimates.append(estimate)
                self._newest = estimate.off_tracking

    def control(self, truth: Truth) -> None:
        """The law's next demand."""
        signals = self.watched.signals.sample(truth)
        self._law, self.demand = self.watched.law.step(self._law, truth.tick, self._newest, signals)

    def _estimate(self, message: Message) -> Estimate | None:
        """What the estimator makes of a message; called in the worker, one message after the other."""
        with self._timed("odometry"):
            self._source, estimate = self.watched.sensing.source.step(self._source, message)
        if isinstance(estimate, CameraOffTracking):
            return Estimate(estimate.off_tracking, estimate.motion)
        return None if estimate is None else Estimate(estimate)
