"""The closed loop: one mutable Session that samples, delivers, controls, logs and integrates, always in that order.

What an estimator makes of a message depends on nothing but the messages before it, so it is worked out beside the loop,
in one thread of its own, between the message's capture and its delivery: the second core would idle otherwise. The
results are the same to the bit.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Literal, get_args

import cv2
import numpy as np

from controllers.driver import PERIOD as DRIVER_PERIOD
from controllers.driver import DriverCommand
from controllers.trailer import SteerCommand
from estimators.estimates import OffTracking
from estimators.viso_ot import VisoOtEstimate
from scenarios.assembly import LOG_PERIOD, Assembly
from scenarios.outcomes import Referee
from scenarios.recording import RecordingWriter
from scenarios.run_log import Estimate, Row
from sensors.messages import BodyPose, StereoFrame
from sensors.navigation import DriverPerception, SteerEncoders
from vehicle.clock import TICK, Pipe, Schedule, to_ticks
from vehicle.frames import Pose2
from vehicle.plant import DivergedError, VehicleCommand
from vehicle.truth import Truth

_CONTROL = Schedule(period=to_ticks(DRIVER_PERIOD, "control period"))  # driver and trailer steering alike
_PATIENCE = 1.5  # a run that takes so much longer than its path at set speed has got stuck
_GRACE = 10.0  # and some time for a start on a slope [s]

Stage = Literal["physics", "render", "odometry", "wait", "total"]  # wait: for the odometry, which runs beside
Message = StereoFrame | BodyPose


class Session:
    """A run in progress: the only mutable object of the house."""

    def __init__(self, parts: Assembly, *, keep_frames: bool = False, recorder: RecordingWriter | None = None) -> None:
        """A session at tick 0, the vehicle standing at the course's start, rolling at set speed."""
        self.parts = parts
        self.tick = 0
        self.outcome: str | None = None  # None while the run goes on
        self.rows: list[Row] = []
        self.estimates: list[Estimate] = []
        self.seconds: dict[Stage, float] = dict.fromkeys(get_args(Stage), 0.0)
        self._keep_frames = keep_frames
        self._recorder = recorder
        self._images = hashlib.sha256()
        self._state = parts.motive.initial_state(parts.course.start, parts.scenario.speed)
        self._referee = Referee(parts.vehicle, parts.course.centreline, parts.course.road_half_width)
        self._lifted = self._referee.init()
        self._station = 0.0  # of the guided point along the course [m]
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="estimator")  # one: messages stay in order
        self._frames: list[tuple[int, Future[bytes]]] = []
        self._in_flight: Pipe[Future[Estimate | None]] = Pipe()
        self._newest: OffTracking | None = None
        self._source = parts.source.init()
        self._steering = parts.trailer_steering.init()
        self._driver: Any = parts.driver.init() if parts.driver else None
        self._encoders = SteerEncoders(parts.steers_ahead, len(parts.trailer.steered_distances))
        self._driver_demand = DriverCommand(steer=0.0, acceleration=0.0)
        self._steer_demand = SteerCommand(angles=np.zeros(len(parts.trailer.steered_distances)))

    def close(self) -> None:
        """Ends the estimator's thread; what has been delivered and kept stays."""
        self._worker.shutdown(cancel_futures=True)

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        """Tick and JPEG of what the left camera saw, for people, if it was to be kept."""
        return [(tick, jpeg.result()) for tick, jpeg in self._frames]

    @property
    def progress(self) -> float:
        """How much of the course is done, 0 to 1."""
        return min(1.0, self._station / self.parts.course.length)

    @property
    def images_sha256(self) -> str:
        """Hash of every image the estimator was given so far."""
        return self._images.hexdigest()

    def advance(self) -> None:
        """One round of the loop: up to and including the integration to the next log row."""
        with self._timed("total"):
            with self._timed("physics"):
                truth = self.parts.motive.observe(self._state, self.tick)
            self._sample(truth)
            self._deliver()
            self._control(truth)
            self.rows.append(Row(truth, self._driver_demand, self._steer_demand))
            self._integrate()
            self._judge(truth)

    def _sample(self, truth: Truth) -> None:
        schedule = self.parts.schedule
        if not schedule.due(self.tick):
            return
        with self._timed("render"):
            message = self.parts.sensor.sample(truth)
            if message is None:
                return
            seen = message if isinstance(message, StereoFrame) else self._seen_for_recording(truth)
        estimate = self._worker.submit(self._estimate, message)
        self._in_flight = self._in_flight.put(self.tick + schedule.latency, estimate)
        if seen is not None:
            self._keep(seen, truth)

    def _seen_for_recording(self, truth: Truth) -> StereoFrame | None:
        return self.parts.cameras.camera.sample(truth) if self.parts.cameras else None

    def _keep(self, frame: StereoFrame, truth: Truth) -> None:
        self._images.update(frame.left.tobytes())
        self._images.update(frame.right.tobytes())
        if self._recorder:
            then = truth if frame.tick == truth.tick else self.rows[frame.tick // LOG_PERIOD].truth  # it came late
            self._recorder.add(frame, then.bodies[self.parts.trailer_unit])
        if self._keep_frames and self.parts.cameras:
            rectified = self.parts.cameras.rectified
            self._frames.append((frame.tick, self._worker.submit(lambda: _jpeg(rectified(frame)))))

    def _estimate(self, message: Message) -> Estimate | None:
        """What the estimator makes of a message; called in the worker, one message after the other."""
        with self._timed("odometry"):
            self._source, estimate = self.parts.source.step(self._source, message)
        if isinstance(estimate, VisoOtEstimate):
            return Estimate(estimate.off_tracking, estimate.motion)
        return None if estimate is None else Estimate(estimate)

    def _deliver(self) -> None:
        self._in_flight, due = self._in_flight.deliver(self.tick)
        for future in due:
            with self._timed("wait"):
                estimate = future.result()
            if estimate is not None:
                self.estimates.append(estimate)
                self._newest = estimate.off_tracking

    def _control(self, truth: Truth) -> None:
        if not _CONTROL.due(self.tick):
            return
        if self.parts.driver:
            ego = DriverPerception().sample(truth)
            self._driver, self._driver_demand = self.parts.driver.step(self._driver, self.tick, ego)
        self._steering, self._steer_demand = self.parts.trailer_steering.step(
            self._steering, self.tick, self._newest, self._encoders.sample(truth)
        )

    def _integrate(self) -> None:
        command = VehicleCommand(
            steer=self._driver_demand.steer,
            acceleration=self._driver_demand.acceleration,
            trailer_steer=tuple(self._steer_demand.angles.tolist()),
        )
        try:
            with self._timed("physics"):
                self._state = self.parts.motive.step(self._state, command, LOG_PERIOD)
        except DivergedError:
            self.outcome = "diverged"
        self.tick += LOG_PERIOD

    def _judge(self, truth: Truth) -> None:
        """Where on the course the tractor is, and whether that or what befell the combination ends the run."""
        course = self.parts.course
        point = Pose2(*truth.poses[0]) @ Pose2(*course.reference, 0.0)
        self._station = course.path.project(point.x, point.y, self._station)
        allowed = _GRACE + _PATIENCE * course.length / self.parts.scenario.speed
        self._lifted, mishap = self._referee.step(self._lifted, truth)
        self.outcome = self.outcome or mishap
        if self.outcome is None and self._station >= course.length - 1e-6:
            self.outcome = "completed"
        elif self.outcome is None and self.tick * TICK > allowed:
            self.outcome = "timed out"

    @contextmanager
    def _timed(self, stage: Stage) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] += time.perf_counter() - begin


def _jpeg(frame: StereoFrame) -> bytes:
    image = frame.left if frame.colour is None else cv2.cvtColor(frame.colour, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", image)[1].tobytes()
