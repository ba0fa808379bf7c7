"""The loop of a rover: instruments, slip estimator, dead reckoning, driver, and the judge that ends a run."""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Final

from estimators.estimates import SlipAngle
from estimators.slip.rover_odometry import LaserSlip, RoverOdometry
from scenarios.assembly.rover_run import PERIOD, RoverAssembly
from scenarios.image_file import PictureSize
from scenarios.loop.channel import Channel, Stopwatch, estimator_thread
from scenarios.loop.image_observers import RoverRecorder, TracePictures
from scenarios.loop.session import RunSession
from scenarios.results.rover_result import RoverRecord, RoverResult, TraceFrame, rover_log, soil_warnings
from scenarios.results.run_inputs import RunInputs
from scenarios.results.run_warnings import fault_warnings
from sensors.messages import LaserFix, Message, RoverReadings
from vehicle.clock import TICK
from vehicle.rover.command import RoverCommand
from vehicle.rover.truth import RoverTruth

# A rover that is nearly two of its lengths off its path does not correct a slip any more, it drives somewhere else. On
# tight circles it is half the radius: from the centre all parts of a circle are equally far.
LOST_AT: Final = 1.0  # largest distance from the path; beyond it the run ends [m]
_LOST_SHARE: Final = 0.5  # of the smallest radius [-]
_PATIENCE: Final = 3.0  # longest duration over that at the wheels' speed; large, because wheels slip much
_GRACE: Final = 10.0  # added for the start [s]
_SPACING: Final = 0.02  # distance between points of the path in figures [m]


class RoverPilot:
    """The rover's navigation and driver."""

    def __init__(self, parts: RoverAssembly, channel: Channel[RoverTruth, Message, SlipAngle]) -> None:
        self._parts, self._channel = parts, channel
        self._driver = parts.driver.init()
        self._odometry = RoverOdometry(parts.geometry)
        start = self._odometry.init(*parts.path.start)
        self._wheels_only, self._corrected, self._navigated = start, start, start
        self._laser_slip, self._laser = LaserSlip(), LaserSlip().init()

    def control(self, truth: RoverTruth, tick: int) -> tuple[RoverCommand, RoverRecord]:
        """Command of this step."""
        scenario, step = self._parts.scenario, self._odometry.step
        readings = self._parts.instruments.sample(truth)
        fix = self._parts.laser.sample(truth) if self._channel.schedule.due(tick) else None  # at the camera's rate
        newest = self._channel.newest
        slip = None if scenario.slip_compensation == "none" else newest
        self._wheels_only, wheels_only = step(self._wheels_only, readings)
        self._corrected, corrected = step(self._corrected, readings, newest)
        position = fix if scenario.navigation == "laser" else None
        self._navigated, navigated = step(self._navigated, readings, slip, position)
        self._driver, command = self._parts.driver.step(self._driver, navigated)
        return command, RoverRecord(
            readings=readings,
            command=command,
            wheels_only=wheels_only,
            corrected=corrected,
            navigated=navigated,
            laser_slip=self._observed_slip(fix, readings),
        )

    def _observed_slip(self, fix: LaserFix | None, readings: RoverReadings) -> float | None:
        if fix is None:
            return None
        self._laser, slip = self._laser_slip.step(self._laser, fix, readings.heading)
        return slip


class RoverJudge:
    """Ends a run at the end of the path, off the path, or when the rover is stuck."""

    def __init__(self, parts: RoverAssembly) -> None:
        self._parts = parts
        self._station = 0.0  # of the true position along the path [m]
        sharpest = max(abs(c) for part in parts.path.segments for c in (part.start_curvature, part.end_curvature))
        self._lost_at = LOST_AT if sharpest == 0.0 else min(LOST_AT, _LOST_SHARE / sharpest)

    @property
    def progress(self) -> float:
        """Share of the path that is done, 0 to 1."""
        return min(1.0, self._station / self._parts.path.length)

    def outcome(self, truth: RoverTruth) -> str | None:
        """Outcome of the run; None if it continues."""
        path = self._parts.path
        x, y, _ = truth.pose.tolist()
        self._station = path.project(x, y, self._station)
        if self._parts.plant.entrapped(truth):
            return "entrapped"
        on_path = path.pose(self._station)  # it goes on straight before the start, where a rover may slide back
        off_path = math.hypot(x - on_path.x, y - on_path.y)
        if max(off_path, -self._station) > self._lost_at:
            return "left the path"
        if self._station >= path.length - 1e-6:
            return "completed"
        elapsed = (truth.tick + PERIOD) * TICK
        return "timed out" if elapsed > _GRACE + _PATIENCE * path.length / self._parts.scenario.speed else None


class RoverSession(RunSession[RoverTruth, RoverCommand, RoverRecord]):
    """The closed-loop run of a rover scenario."""

    def __init__(
        self,
        parts: RoverAssembly,
        *,
        keep_frames: PictureSize | bool = False,
        recorder: RoverRecorder | None = None,
        worker: Executor | None = None,
    ) -> None:
        """Begin at tick 0 at the start of the path, wheels turning for the set speed.

        Args:
            parts: parts of the run.
            keep_frames: keep colour pictures of the camera for the report, as captured or of this size.
            recorder: receives the camera's views.
            worker: runs the estimator, one message after the other; None: a thread of its own.
        """
        self.parts = parts
        self.worker = worker or estimator_thread()
        stopwatch = Stopwatch()
        sensing = parts.sensing
        self.channel: Channel[RoverTruth, Message, SlipAngle] = Channel(
            sensing.sensor, sensing.schedule, sensing.estimator, self.worker, stopwatch, SlipAngle
        )
        self.pictures = TracePictures(
            parts.view.camera if parts.view else None, self.worker, stopwatch, keep=keep_frames, recorder=recorder
        )
        channels = [self.channel]
        if parts.recording is not None:
            channels.append(Channel(parts.recording, sensing.schedule, None, self.worker, stopwatch))
        super().__init__(
            parts.plant,
            parts.plant.initial_state(parts.path.start, parts.scenario.speed),
            period=PERIOD,
            pilot=RoverPilot(parts, self.channel),
            judge=RoverJudge(parts),
            channels=channels,
            observers=[self.pictures, *([parts.view] if parts.view is not None else [])],
            stopwatch=stopwatch,
        )

    @property
    def estimates(self) -> Sequence[SlipAngle]:
        """Estimates delivered so far, oldest first."""
        return self.channel.delivered

    @property
    def estimate(self) -> SlipAngle | None:
        """The slip angle delivered last."""
        return self.channel.newest

    def result(self, inputs: RunInputs, *, complete: bool = True) -> RoverResult:
        """Result of the run as far as it has come."""
        parts = self.parts
        scenario = parts.scenario
        log = rover_log(parts.rig, self.rows, self.estimates, parts.path, faults=bool(scenario.faults))
        return RoverResult(
            scenario=scenario.name,
            scenario_toml=scenario.to_toml(),
            seed=parts.seed,
            outcome=self.outcome or "unfinished",
            log=log,
            rover=parts.rover.name,
            path=parts.path.points(_SPACING),
            rig=parts.rig,
            timing=self.stopwatch.timing(self.tick * TICK),
            frames=tuple(TraceFrame(tick=tick, jpeg=jpeg) for tick, jpeg in self.pictures.frames),
            manifest={"frames_sha256": self.pictures.sha256 if parts.view else "none"},
            warnings=(
                *parts.remarks,
                *fault_warnings(((f.kind, f.start) for f in scenario.faults), self.outcome, self.tick * TICK),
                *(soil_warnings(log) if scenario.surface.soil != "none" else ()),
            ),
            traceback=self.traceback,
            inputs=inputs,
        )
