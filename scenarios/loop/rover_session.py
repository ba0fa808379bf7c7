"""The closed loop of a rover: sample, deliver, control, log, integrate, always in that order.

As in ``scenarios.loop.session``, the slip estimator works in a thread of its own between the capture of a view and its
delivery; the results are the same to the bit.
"""

from __future__ import annotations

import hashlib
import math
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from estimators.estimates import SlipAngle
from estimators.slip.reference import LaserSlip
from estimators.slip.rover_odometry import RoverOdometry, RoverPose
from scenarios.assembly.rover import PERIOD, RoverAssembly
from scenarios.loop.stopwatch import Stopwatch
from sensors.instruments.rover_navigation import ExactSlip
from sensors.messages import LaserFix, RoverReadings, RoverView
from vehicle.clock import TICK, Pipe
from vehicle.combination.plant import DivergedError
from vehicle.rover.command import RoverCommand
from vehicle.rover.truth import RoverTruth

_PATIENCE = 3.0  # a run that takes so much longer than its path at the wheels' speed has got stuck: wheels slip much
_GRACE = 10.0  # and some time to start [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverRow:
    """What was so, what was believed and what was demanded at one tick."""

    truth: RoverTruth
    readings: RoverReadings
    command: RoverCommand
    wheels_only: RoverPose  # dead reckoning without any slip
    corrected: RoverPose  # the same with the slip angle
    navigated: RoverPose  # what the driver steers by
    station: float  # of the true place along the path [m]
    laser_slip: float | None  # [rad], of LaserSlip.delay() ago


class RoverSession:
    """A rover's run in progress."""

    def __init__(self, parts: RoverAssembly, *, keep_frames: bool = False, recorder: Any = None) -> None:
        """A session at tick 0, the rover at the path's start, rolling at set speed."""
        self.parts = parts
        self.tick = 0
        self.outcome: str | None = None  # None while the run goes on
        self.rows: list[RoverRow] = []
        self.estimates: list[SlipAngle] = []
        self.frames: list[tuple[int, bytes]] = []  # tick and JPEG of what the camera saw, for people
        self.stopwatch = Stopwatch()
        self._keep_frames, self._recorder = keep_frames, recorder
        self._images = hashlib.sha256()
        self._state = parts.plant.initial_state(parts.path.start, parts.scenario.speed)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="estimator")
        self._in_flight: Pipe[Future[SlipAngle]] = Pipe()
        self._newest: SlipAngle | None = None
        self._source = parts.source.init()
        self._driver = parts.driver.init()
        self._odometry = RoverOdometry(parts.geometry)
        start = self._odometry.init(*parts.path.start)
        self._wheels_only, self._corrected, self._navigated = start, start, start
        self._laser_slip, self._laser = LaserSlip(), LaserSlip().init()
        self._driven: list[RoverTruth] = []  # since the last look at the ground
        self._station = 0.0

    def close(self) -> None:
        """Ends the estimator's thread."""
        self._worker.shutdown(cancel_futures=True)

    @property
    def progress(self) -> float:
        """How much of the course is done, 0 to 1."""
        return min(1.0, self._station / self.parts.path.length)

    @property
    def images_sha256(self) -> str:
        """Hash of every image the estimator was given so far."""
        return self._images.hexdigest()

    def advance(self) -> None:
        """One round of the loop: up to and including the integration to the next log row."""
        with self.stopwatch.timed("total"):
            with self.stopwatch.timed("physics"):
                truth = self.parts.plant.observe(self._state, self.tick)
            if self.parts.world is not None:
                self._driven.append(truth)
            readings = self.parts.instruments.sample(truth)
            fix = self._fixed(truth)
            self._sample(truth, readings)
            self._deliver()
            command, poses = self._control(readings, fix)
            self._log(truth, readings, command, poses, fix)
            self._integrate(command)
            self._judge(truth)

    def _fixed(self, truth: RoverTruth) -> LaserFix | None:
        """The tracker looks as often as the camera does."""
        return self.parts.laser.sample(truth) if self.parts.schedule.due(self.tick) else None

    def _sample(self, truth: RoverTruth, readings: RoverReadings) -> None:
        schedule = self.parts.schedule
        if not schedule.due(self.tick):
            return
        view = self._view(truth, readings)
        message = (
            view if self.parts.scenario.slip_estimator != "truth" else ExactSlip(self.parts.rig.watched).sample(truth)
        )
        estimate = self._worker.submit(self._estimate, message)
        self._in_flight = self._in_flight.put(self.tick + schedule.latency, estimate)
        if view is not None:
            self._keep(view, truth)

    def _view(self, truth: RoverTruth, readings: RoverReadings) -> RoverView | None:
        """What the camera sees, with the ground as the wheels have left it by now."""
        world, camera = self.parts.world, self.parts.camera
        if world is None or camera is None:
            return None
        with self.stopwatch.timed("render"):
            world.drive(self._driven)
            self._driven = []
            return RoverView(
                tick=self.tick,
                image=camera.sample(truth),
                heading=readings.heading,
                wheel_speeds=readings.wheel_speeds,
                steer=readings.steer,
            )

    def _keep(self, view: RoverView, truth: RoverTruth) -> None:
        """What of a view is for people and recordings; the estimator is at work on it meanwhile."""
        self._images.update(view.image.tobytes())
        if self._recorder:
            self._recorder.add(view, truth)
        if self._keep_frames and self.parts.camera is not None:
            with self.stopwatch.timed("render"):
                self.frames.append((self.tick, _jpeg(self.parts.camera.colour(truth))))

    def _estimate(self, message: Any) -> SlipAngle:
        """What the estimator makes of a message; called in the worker, one message after the other."""
        with self.stopwatch.timed("odometry"):
            self._source, estimate = self.parts.source.step(self._source, message)
        return estimate

    def _deliver(self) -> None:
        self._in_flight, due = self._in_flight.deliver(self.tick)
        for future in due:
            with self.stopwatch.timed("wait"):
                self._newest = future.result()
            self.estimates.append(self._newest)

    def _control(
        self, readings: RoverReadings, fix: LaserFix | None
    ) -> tuple[RoverCommand, tuple[RoverPose, RoverPose, RoverPose]]:
        scenario, step = self.parts.scenario, self._odometry.step
        slip = None if scenario.slip_compensation == "none" else self._newest
        given = fix if scenario.navigation == "laser" else None
        self._wheels_only, wheels_only = step(self._wheels_only, readings)
        self._corrected, corrected = step(self._corrected, readings, self._newest)
        self._navigated, navigated = step(self._navigated, readings, slip, given)
        self._driver, command = self.parts.driver.step(self._driver, navigated)
        return command, (wheels_only, corrected, navigated)

    def _log(
        self,
        truth: RoverTruth,
        readings: RoverReadings,
        command: RoverCommand,
        poses: tuple[RoverPose, RoverPose, RoverPose],
        fix: LaserFix | None,
    ) -> None:
        laser_slip = None
        if fix is not None:
            self._laser, laser_slip = self._laser_slip.step(self._laser, fix, readings.heading)
        x, y, _ = truth.pose.tolist()
        self._station = self.parts.path.project(x, y, self._station)
        wheels_only, corrected, navigated = poses
        row = RoverRow(
            truth=truth,
            readings=readings,
            command=command,
            wheels_only=wheels_only,
            corrected=corrected,
            navigated=navigated,
            station=self._station,
            laser_slip=laser_slip,
        )
        self.rows.append(row)

    def _integrate(self, command: RoverCommand) -> None:
        try:
            with self.stopwatch.timed("physics"):
                self._state = self.parts.plant.step(self._state, command, PERIOD)
        except DivergedError:
            self.outcome = "diverged"
        self.tick += PERIOD

    def _judge(self, truth: RoverTruth) -> None:
        """Whether the rover has come to the end, believes so, or got stuck."""
        path = self.parts.path
        if self.outcome is None and self.parts.plant.entrapped(truth):
            self.outcome = "entrapped"
        elif self.outcome is None and self._station >= path.length - 1e-6:
            self.outcome = "completed"
        elif self.outcome is None and self.tick * TICK > _GRACE + _PATIENCE * path.length / self.parts.scenario.speed:
            self.outcome = "timed out"


def cross_track(parts: RoverAssembly, row: RoverRow) -> float:
    """How far R's origin really is beside the path, + left [m]."""
    on_path = parts.path.pose(row.station)
    x, y = float(row.truth.pose[0]), float(row.truth.pose[1])
    return math.cos(on_path.psi) * (y - on_path.y) - math.sin(on_path.psi) * (x - on_path.x)


def _jpeg(colour: np.ndarray[Any, np.dtype[np.uint8]]) -> bytes:
    return cv2.imencode(".jpg", cv2.cvtColor(colour, cv2.COLOR_RGB2BGR))[1].tobytes()
