"""The closed-loop run of a combination: pilot, channels of the trailers, pictures and judge in one session."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from functools import partial

from scenarios.assembly.trailer import LOG_PERIOD, Assembly
from scenarios.hil.link import Link
from scenarios.loop.bench import opened_bench
from scenarios.loop.channel import Channel, estimator_thread
from scenarios.loop.course_judge import CourseJudge
from scenarios.loop.pictures import StereoPictures
from scenarios.loop.pilot import CombinationPilot, OffTrackingEstimate, SteeredTrailer
from scenarios.loop.session import Session
from scenarios.loop.stopwatch import Stopwatch
from scenarios.recordings.stereo_writer import RecordingWriter
from scenarios.results.trailer_signals import CombinationRecord
from sensors.sensor import Message
from vehicle.combination.plant import VehicleCommand
from vehicle.combination.truth import Truth


class TrailerSession(Session[Truth, VehicleCommand, CombinationRecord], AbstractContextManager["TrailerSession"]):
    """The closed-loop run of a trailer scenario."""

    def __init__(
        self,
        parts: Assembly,
        *,
        keep_frames: bool = False,
        recorder: RecordingWriter | None = None,
        worker: Executor | None = None,
        renderer: Executor | None = None,
        links: Sequence[Link] = (),
        is_paced: bool = False,
    ) -> None:
        """Begin at tick 0 at the start of the course, rolling at set speed.

        Args:
            parts: parts of the run.
            keep_frames: keep pictures of the last trailer's left camera for the report.
            recorder: receives the last trailer's stereo frames.
            worker: runs the estimators, one message after the other; None: a thread of its own.
            renderer: renders the cameras, one picture after the other, while the loop goes on: the thread that has
                assembled ``parts``. None: the loop renders.
            links: to a bench, which gets the signals and may steer as the scenario says.
            is_paced: the run keeps wall time.

        Raises:
            ValueError: one line, if the scenario asks for demands from outside that nobody gives.
        """
        self.parts = parts
        self.bench = opened_bench(parts, links, is_paced=is_paced)
        self._worker, self._renderer = worker or estimator_thread(), renderer
        stopwatch = Stopwatch()
        self.trailers = tuple(
            SteeredTrailer(trailer, self._worker, stopwatch, renderer=renderer, see=partial(self._see, number))
            for number, trailer in enumerate(parts.trailers)
        )
        channels: list[Channel[Truth, Message, OffTrackingEstimate]] = [trailer.channel for trailer in self.trailers]
        if parts.recording is not None:
            recording = parts.recording
            see = partial(self._see, len(channels))
            channels.append(
                Channel(recording.sensor, recording.schedule, None, self._worker, stopwatch, renderer=renderer, see=see)
            )
        self.pictures = StereoPictures(
            len(channels) - 1, parts.trailers[-1].unit, parts.cameras, self._worker, keep=keep_frames, recorder=recorder
        )
        super().__init__(
            parts.plant,
            parts.plant.initial_state(parts.course.start, parts.start_speed),
            period=LOG_PERIOD,
            pilot=CombinationPilot(
                parts.vehicle,
                parts.driver.driver if parts.driver else None,
                self.trailers,
                self.bench,
                parts.brake_faults,
            ),
            judge=CourseJudge(parts),
            channels=channels,
            observers=[self.pictures],
            stopwatch=stopwatch,
        )

    def _see(self, channel: int, message: Message, truth: Truth) -> None:
        self.pictures.see(channel, message, truth)

    def finish_pictures(self) -> None:
        """Wait until all pictures taken so far are rendered."""
        if self._renderer is not None:
            self._renderer.submit(lambda: None).result()

    def close(self) -> None:
        """End the estimator's thread; delivered estimates stay."""
        self._worker.shutdown(cancel_futures=True)

    def __exit__(self, *_: object) -> None:
        self.close()
