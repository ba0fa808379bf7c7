"""The closed loop: one mutable Session that samples, delivers, controls, logs and integrates, always in that order."""

from __future__ import annotations

import hashlib
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np

from controllers.driver import PERIOD as DRIVER_PERIOD
from controllers.driver import DriverCommand
from scenarios.assembly.trailer import LOG_PERIOD, Assembly
from scenarios.loop.referee import Referee
from scenarios.loop.stopwatch import Stopwatch
from scenarios.loop.trailer_loop import TrailerLoop
from scenarios.recordings.stereo_writer import RecordingWriter
from scenarios.results.trailer_signals import Estimate, Row
from sensors.instruments.navigation import DriverPerception
from sensors.messages import StereoFrame
from vehicle.clock import TICK, Schedule, to_ticks
from vehicle.combination.plant import DivergedError, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import Pose2

_CONTROL = Schedule(period=to_ticks(DRIVER_PERIOD, "control period"))  # driver and trailer steering alike
_PATIENCE = 1.5  # a run that takes so much longer than its path at set speed has got stuck
_GRACE = 10.0  # and some time for a start on a slope [s]


class Session:
    """A run in progress: the only mutable object of the house."""

    def __init__(self, parts: Assembly, *, keep_frames: bool = False, recorder: RecordingWriter | None = None) -> None:
        """A session at tick 0, the vehicle standing at the course's start, rolling at set speed."""
        self.parts = parts
        self.tick = 0
        self.outcome: str | None = None  # None while the run goes on
        self.rows: list[Row] = []
        self.stopwatch = Stopwatch()
        self._keep_frames = keep_frames
        self._recorder = recorder
        self._images = hashlib.sha256()
        self._records_only = parts.cameras is not None and not parts.trailers[-1].sensing.sees
        self._state = parts.motive.initial_state(parts.course.start, parts.start_speed)
        road = None if parts.is_recorded else parts.course.centreline  # where a recorded drive's was is not known
        self._referee = Referee(parts.vehicle, road, parts.course.road_half_width)
        self._lifted = self._referee.init()
        self._station = 0.0  # of the guided point along the course [m]
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="estimator")  # one: messages stay in order
        self._frames: list[tuple[int, Future[bytes]]] = []
        self.trailers = tuple(TrailerLoop(trailer, self._worker, self.stopwatch.timed) for trailer in parts.trailers)
        self._driver: Any = parts.driver.init() if parts.driver else None
        self._driver_demand = DriverCommand(steer=0.0, acceleration=0.0)
        self._n_trailer_axles = sum(len(unit.steered_axles) for unit in parts.vehicle.units[1:])

    @property
    def estimates(self) -> list[Estimate]:
        """Those of the last trailer that have been delivered."""
        return self.trailers[-1].estimates

    def close(self) -> None:
        """Ends the estimator's thread; what has been delivered and kept stays."""
        self._worker.shutdown(cancel_futures=True)

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        """Tick and JPEG of what the left camera saw, for people, if it was to be kept."""
        return [(tick, jpeg.result()) for tick, jpeg in self._frames]

    @property
    def progress(self) -> float:
        """How much of the course, or of a recorded drive, is done, 0 to 1."""
        if self.parts.is_recorded:
            return min(1.0, self.tick * TICK / self.parts.duration)
        return min(1.0, self._station / self.parts.course.length)

    @property
    def images_sha256(self) -> str:
        """Hash of every image the estimator was given so far."""
        return self._images.hexdigest()

    def advance(self) -> None:
        """One round of the loop: up to and including the integration to the next log row."""
        with self.stopwatch.timed("total"):
            with self.stopwatch.timed("physics"):
                truth = self.parts.motive.observe(self._state, self.tick)
            self._sample(truth)
            for trailer in self.trailers:
                trailer.deliver(self.tick)
            self._control(truth)
            demands = tuple(trailer.demand for trailer in self.trailers)
            self.rows.append(Row(truth, self._driver_demand, demands))
            self._integrate()
            self._judge(truth)

    def _sample(self, truth: Truth) -> None:
        seen: StereoFrame | None = None
        for trailer in self.trailers:
            if not trailer.watched.sensing.schedule.due(self.tick):
                continue
            with self.stopwatch.timed("render"):
                message = trailer.watched.sensing.sensor.sample(truth)
            if message is not None:
                trailer.send(message, self.tick)
            seen = message if isinstance(message, StereoFrame) else None
            if seen is not None:
                self._images.update(seen.left.tobytes())
                self._images.update(seen.right.tobytes())
        if seen is None and self._records_only and self.parts.schedule.due(self.tick):
            seen = self._seen_for_recording(truth)
        if seen is not None:
            self._keep(seen, truth)

    def _seen_for_recording(self, truth: Truth) -> StereoFrame | None:
        if self.parts.cameras is None:
            return None
        with self.stopwatch.timed("render"):
            seen = self.parts.cameras.camera.sample(truth)
        self._images.update(seen.left.tobytes())
        self._images.update(seen.right.tobytes())
        return seen

    def _keep(self, frame: StereoFrame, truth: Truth) -> None:
        if self._recorder:
            then = truth if frame.tick == truth.tick else self.rows[frame.tick // LOG_PERIOD].truth  # it came late
            self._recorder.add(frame, then.bodies[self.parts.trailer_unit])
        if self._keep_frames and self.parts.cameras:
            rectified = self.parts.cameras.rectified
            self._frames.append((frame.tick, self._worker.submit(lambda: _jpeg(rectified(frame)))))

    def _control(self, truth: Truth) -> None:
        if not _CONTROL.due(self.tick):
            return
        if self.parts.driver:
            ego = DriverPerception().sample(truth)
            self._driver, self._driver_demand = self.parts.driver.step(self._driver, self.tick, ego)
        for trailer in self.trailers:
            trailer.control(truth)

    def _trailer_steer(self) -> tuple[float, ...]:
        """Demands for every steered trailer axle [rad]; those of trailers that nothing is to follow stay straight."""
        angles = np.zeros(self._n_trailer_axles)
        of_tractor = len(self.parts.vehicle.units[0].steered_axles)
        for trailer in self.trailers:
            first = trailer.watched.steers_ahead - of_tractor
            angles[first : first + trailer.watched.n_steered] = trailer.demand.angles
        return tuple(angles.tolist())

    def _integrate(self) -> None:
        command = VehicleCommand(
            steer=self._driver_demand.steer,
            acceleration=self._driver_demand.acceleration,
            trailer_steer=self._trailer_steer(),
            gear=self._driver_demand.gear,
        )
        try:
            with self.stopwatch.timed("physics"):
                self._state = self.parts.motive.step(self._state, command, LOG_PERIOD)
        except DivergedError:
            self.outcome = "diverged"
        self.tick += LOG_PERIOD

    def _judge(self, truth: Truth) -> None:
        """Where on the course the tractor is, and whether that or what befell the combination ends the run."""
        self._lifted, mishap = self._referee.step(self._lifted, truth)
        self.outcome = self.outcome or mishap
        if self.parts.is_recorded:
            if self.outcome is None and self.tick * TICK >= self.parts.duration:
                self.outcome = "completed"
            return
        course = self.parts.course
        point = Pose2(*truth.poses[0]) @ Pose2(*course.reference, 0.0)
        self._station = course.path.project(point.x, point.y, self._station)
        allowed = _GRACE + _PATIENCE * self.parts.duration
        if self.outcome is None and self._station >= course.length - 1e-6:
            self.outcome = "completed"
        elif self.outcome is None and self.tick * TICK > allowed:
            self.outcome = "timed out"


def _jpeg(frame: StereoFrame) -> bytes:
    image = frame.left if frame.colour is None else cv2.cvtColor(frame.colour, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", image)[1].tobytes()
