"""The closed-loop run of a combination: its driver, its steered trailers, and their session."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from controllers.driver import DriverCommand, DriverLike
from controllers.trailer import SteerCommand
from controllers.trailer_steering.actuators import ActuatorFinding
from controllers.trailer_steering.lqr import law_warnings
from controllers.trailer_steering.safeguarded import SafeguardedCommand
from estimators.estimates import CameraOffTracking, OffTracking, lost_motion
from estimators.off_tracking.signal_monitor import Finding
from scenarios.assembly.adapters import outlines
from scenarios.assembly.applied_faults import LoopFaults
from scenarios.assembly.trailer_run import LOG_PERIOD, Assembly, WatchedTrailer, trailer_stream
from scenarios.image_file import PictureSize
from scenarios.loop.bench import DRIVER, RECORD_NAME, Bench, Exchange, Sensed, opened_exchange
from scenarios.loop.channel import CONTROL, Channel, Stateful, Stopwatch, estimator_thread
from scenarios.loop.image_observers import StereoPictures, StereoRecorder
from scenarios.loop.referee import CourseJudge, lift_warnings
from scenarios.loop.session import RunSession
from scenarios.options.scenario import Scenario
from scenarios.progress import Progress, no_progress
from scenarios.results.log import Log
from scenarios.results.run_inputs import RunInputs
from scenarios.results.run_summary import Outside
from scenarios.results.run_warnings import (
    SteeredAxle,
    actuator_warnings,
    calibration_warnings,
    doubt_warnings,
    fault_warnings,
    signal_warnings,
    steer_warnings,
)
from scenarios.results.trailer_result import CameraFrame, JudgedTrailer, MountedCamera, RunResult, friction_picture
from scenarios.results.trailer_signals import (
    CombinationRecord,
    Estimate,
    ReferenceOffTracking,
    TrailerTrack,
    run_log,
)
from sensors.instruments.navigation import DriverPerception
from sensors.messages import Message
from vehicle.clock import TICK
from vehicle.combination.data_sheet import data_sheet
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray

MemoryT = TypeVar("MemoryT")
OffTrackingEstimate = OffTracking | CameraOffTracking


class SteeredTrailer:
    """A watched trailer in a running loop: its channel, its steering law, and the law's latest demand."""

    def __init__(
        self,
        trailer: WatchedTrailer,
        worker: Executor,
        stopwatch: Stopwatch,
        *,
        renderer: Executor | None = None,
        see: Callable[[Message, Truth], None] | None = None,
    ) -> None:
        sensing = trailer.sensing
        self.trailer = trailer
        self.channel: Channel[Truth, Message, OffTrackingEstimate] = Channel(
            sensing.sensor,
            sensing.schedule,
            sensing.estimator,
            worker,
            stopwatch,
            OffTracking,
            CameraOffTracking,
            renderer=renderer if sensing.cameras else None,
            see=see,
        )
        self._by_law = SafeguardedCommand(angles=np.zeros(trailer.n_steered))
        self.demand: SteerCommand = self._by_law
        self.off_tracking: OffTracking | None = None  # newest that has reached the law
        self._received = 0  # estimates of the channel that were sent to the law
        self._arrived = self.demand.angles  # demand at the actuators [rad]
        self.handovers: list[tuple[int, bool]] = []  # ticks at which law and fallback change; True: to the fallback
        self._steered_by_bench = False
        self._law = Stateful(trailer.law.init(), trailer.law.step)

    @property
    def estimates(self) -> Iterable[Estimate]:
        """Estimates delivered so far, oldest first; to be read once."""
        return map(as_estimate, self.channel.delivered)

    @property
    def newest(self) -> OffTracking | None:
        """The off-tracking delivered last."""
        return None if self.channel.newest is None else as_estimate(self.channel.newest).off_tracking

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Signals that the law's guard has found at fault so far."""
        return self._by_law.signal_findings

    @property
    def actuator_findings(self) -> tuple[ActuatorFinding, ...]:
        """Faults of the steering actuators that the law's supervision has found so far; none if a bench has steered."""
        return () if self._steered_by_bench else self._by_law.actuator_findings

    def obey(self, demand: FloatArray) -> None:
        """Take the demand (n_steered,) [rad] of a bench in place of the law's."""
        self.demand, self._steered_by_bench = SteerCommand(angles=demand), True

    def receive(self, tick: int) -> None:
        """Send the estimates delivered by this tick to the law, where faults let them through."""
        delivered = self.channel.delivered
        sent = delivered[self._received :] if len(delivered) > self._received else []
        self._received += len(sent)
        arrived = self.trailer.faults.carried("estimates", tick, sent)
        if arrived:
            self.off_tracking = as_estimate(arrived[-1]).off_tracking

    def actuate(self, truth: Truth, *, is_new: bool) -> FloatArray:
        """Demand (n_steered,) [rad] for the plant: the law's, as faults change it; ``is_new``: it is of this tick."""
        faults, sent = self.trailer.faults, [self.demand.angles] if is_new else []
        for demand in faults.carried("demands", truth.tick, sent):
            self._arrived = demand
        first = self.trailer.steers_ahead
        angles = truth.steer[first : first + self.trailer.n_steered]
        return faults.demanded(truth.tick, self._arrived, angles)

    def control(self, truth: Truth) -> None:
        """Update the law's demand."""
        self.demand = self._by_law = self._law(truth.tick, self.off_tracking, self.trailer.signals.sample(truth))
        by_fallback = self._by_law.by_fallback
        if by_fallback != (bool(self.handovers) and self.handovers[-1][1]):
            self.handovers.append((truth.tick, by_fallback))


class CombinationPilot:
    """Driver and trailer steering together; both are updated at the driver's rate and hold in between."""

    def __init__(
        self,
        vehicle: Vehicle,
        driver: DriverLike[MemoryT] | None,
        trailers: Sequence[SteeredTrailer],
        exchange: Exchange | None = None,
        brakes: LoopFaults | None = None,
    ) -> None:
        """Create the pilot of a ``vehicle``; without a driver its motion is prescribed.

        Demands from the ``exchange`` with a bench replace those of driver and laws. ``brakes`` has the brakes' faults.
        """
        self.trailers = trailers
        self._exchange, self._brakes = exchange, brakes or LoopFaults()
        self._driver = None if driver is None else Stateful(driver.init(), driver.step)
        self._driver_demand = DriverCommand(steer=0.0, acceleration=0.0)
        self._perception = DriverPerception(vehicle.units[0].origin_x)
        self._of_driver, self._n_by_law = vehicle.units[0].n_by_driver, vehicle.n_by_law

    def control(self, truth: Truth, tick: int) -> tuple[VehicleCommand, CombinationRecord]:
        """Command of this step."""
        for trailer in self.trailers:
            trailer.receive(tick)
        due = CONTROL.due(tick)
        if due:
            if self._driver:
                self._driver_demand = self._driver(tick, self._perception.sample(truth))
            for trailer in self.trailers:
                trailer.control(truth)
            if self._exchange:
                self._obey(self._exchange, truth)
        demand = self._driver_demand
        steer = self._trailer_steer(truth, is_new=due)
        command = VehicleCommand(demand.steer, demand.acceleration, steer, demand.gear, self._brakes.shares(tick))
        return command, CombinationRecord(demand, tuple(trailer.demand for trailer in self.trailers))

    def _obey(self, exchange: Exchange, truth: Truth) -> None:
        """Send the signals of this step, and take the demands of the bench."""
        sensed = [
            Sensed(one.trailer.name, one.off_tracking, one.trailer.signals.sample(truth)) for one in self.trailers
        ]
        demands = exchange.step(truth.tick, self._perception.sample(truth), sensed)
        for trailer in self.trailers:
            if trailer.trailer.name in demands:
                trailer.obey(np.array(demands[trailer.trailer.name]))
        if DRIVER in demands:
            self._driver_demand = DriverCommand(*demands[DRIVER])

    def _trailer_steer(self, truth: Truth, *, is_new: bool) -> tuple[float, ...]:
        """Demands for every axle that laws turn [rad]; axles of trailers that are not watched stay straight."""
        angles = np.zeros(self._n_by_law)
        for trailer in self.trailers:
            first = trailer.trailer.steers_ahead - self._of_driver
            angles[first : first + trailer.trailer.n_steered] = trailer.actuate(truth, is_new=is_new)
        return tuple(angles.tolist())


def as_estimate(delivered: OffTrackingEstimate) -> Estimate:
    """A delivered estimate with the camera motion behind it, if there is one."""
    if isinstance(delivered, CameraOffTracking):
        return Estimate(delivered.off_tracking, delivered.motion)
    return Estimate(delivered)


class TrailerSession(RunSession[Truth, VehicleCommand, CombinationRecord]):
    """The closed-loop run of a trailer scenario."""

    def __init__(
        self,
        parts: Assembly,
        *,
        keep_frames: PictureSize | bool = False,
        recorder: StereoRecorder | None = None,
        worker: Executor | None = None,
        renderer: Executor | None = None,
        bench: Bench | None = None,
        is_paced: bool = False,
    ) -> None:
        """Begin at tick 0 at the start of the course, rolling at set speed.

        Args:
            parts: parts of the run.
            keep_frames: keep pictures of the last trailer's left camera for the report, as captured or of this size.
            recorder: receives the last trailer's stereo frames.
            worker: runs the estimators, one message after the other; None: a thread of its own.
            renderer: renders the cameras, one picture after the other, while the loop goes on: the thread that has
                assembled ``parts``. None: the loop renders.
            bench: gets the signals and may steer as the scenario says.
            is_paced: the run keeps wall time.

        Raises:
            ValueError: one line, if the scenario asks for demands from outside that nobody gives.
        """
        self.parts = parts
        self.exchange = opened_exchange(parts, bench, is_paced=is_paced)
        self.worker, self._renderer = worker or estimator_thread(), renderer
        stopwatch = Stopwatch()
        last = len(parts.trailers) - (parts.recording is None)  # channel that is recorded and kept
        self.pictures = StereoPictures(
            last, parts.trailers[-1].unit, parts.cameras, self.worker, keep=keep_frames, recorder=recorder
        )
        self.trailers = tuple(
            SteeredTrailer(trailer, self.worker, stopwatch, renderer=renderer, see=partial(self.pictures.see, number))
            for number, trailer in enumerate(parts.trailers)
        )
        channels: list[Channel[Truth, Message, OffTrackingEstimate]] = [trailer.channel for trailer in self.trailers]
        if parts.recording is not None:
            recording = parts.recording
            see = partial(self.pictures.see, last)
            channels.append(
                Channel(recording.sensor, recording.schedule, None, self.worker, stopwatch, renderer=renderer, see=see)
            )
        super().__init__(
            parts.plant,
            parts.plant.initial_state(parts.course.start, parts.start_speed),
            period=LOG_PERIOD,
            pilot=CombinationPilot(
                parts.vehicle,
                parts.driver.driver if parts.driver else None,
                self.trailers,
                self.exchange,
                parts.brake_faults,
            ),
            judge=CourseJudge(parts),
            channels=channels,
            observers=[self.pictures],
            stopwatch=stopwatch,
        )

    @property
    def estimate(self) -> OffTracking | None:
        """The off-tracking of the last trailer that was delivered last."""
        return self.trailers[-1].newest

    def run(self, progress: Progress = no_progress) -> None:
        """Advance until there is an outcome, and wait for the pictures that are still rendered."""
        super().run(progress)
        if self._renderer is not None:
            self._renderer.submit(lambda: None).result()

    def result(self, inputs: RunInputs, *, complete: bool = True) -> RunResult:
        """Result as far as the run has come; without the reference unit's signals it takes a fifth."""
        parts = self.parts
        vehicle = parts.vehicle
        outside = self.exchange.report() if self.exchange else None
        scenario, inputs = _with_record(parts.scenario, inputs, outside)
        with_unit = complete and scenario.reference_unit
        tracks = [track_of(self, trailer, with_unit=with_unit) for trailer in self.trailers]
        log = run_log(self.rows, tracks, vehicle)
        return RunResult(
            scenario=scenario.name,
            scenario_toml=scenario.to_toml(),
            seed=parts.seed,
            outcome=self.outcome or "unfinished",
            log=log,
            units=outlines(vehicle),
            trailers=tuple(
                JudgedTrailer(
                    name=trailer.name,
                    follow_distance=trailer.geometry.follow_distance,
                    n_steered=trailer.n_steered,
                    max_steer=trailer.geometry.max_steer or None,
                )
                for trailer in parts.trailers
            ),
            road=parts.course.centreline,
            road_half_width=parts.course.road_half_width,
            things=parts.course.things,
            lanes=parts.course.lanes,
            friction=friction_picture(parts.surface, parts.course.centreline),
            road_known=parts.trace is None,
            circle_centre=parts.course.surface_centre,
            arcs=parts.course.arcs,
            path_deviation=parts.course.deviation,
            placement=parts.course.placement.record() if parts.course.placement else {},
            timing=self.stopwatch.timing(self.tick * TICK),
            frames=_camera_frames(self),
            cameras=tuple(
                MountedCamera(trailer.unit, trailer.sensing.cameras.calibration)
                for trailer in parts.trailers
                if trailer.sensing.cameras
            ),
            manifest={
                "opengl_renderer": parts.views.renderer_name,
                "frames_sha256": self.pictures.sha256 if parts.cameras else "none",
                "recording_sha256": self.pictures.recording_sha256 if parts.cameras else "none",
            },
            warnings=(
                *filter(None, (self.reason,)),
                *parts.remarks,
                *fault_warnings(((f.kind, f.start) for f in scenario.faults), self.outcome, self.tick * TICK),
                *data_sheet(vehicle).warnings,
                *_steer_warnings(parts, log),
                *_camera_warnings(self),
                *_signal_warnings(self),
                *_speed_warnings(parts, log),
                *lift_warnings(vehicle, log),
            ),
            traceback=self.traceback,
            inputs=inputs,
            outside=outside,
        )


def track_of(session: TrailerSession, trailer: SteeredTrailer, *, with_unit: bool) -> TrailerTrack:
    """A trailer's estimates, and the reference unit on it if there is one."""
    watched, cameras = trailer.trailer, trailer.trailer.sensing.cameras
    n, has_faults = len(session.rows), bool(session.parts.scenario.faults)
    return TrailerTrack(
        name=watched.name,
        unit=watched.unit,
        follow_distance=watched.geometry.follow_distance,
        path_height=watched.path_height,
        steers_ahead=watched.steers_ahead,
        n_steered=watched.n_steered,
        estimates=trailer.estimates,
        X_SC=cameras.calibration.X_SC if cameras else None,
        reference=_reference(session, trailer) if with_unit else None,
        fallback=_fallback(trailer, n) if has_faults else None,
        distrusted=_distrusted(trailer, n) if has_faults else None,
        axles_at_fault=_axles_at_fault(trailer, n) if has_faults else None,
    )


def _reference(session: TrailerSession, trailer: SteeredTrailer) -> ReferenceOffTracking:
    parts, watched = session.parts, trailer.trailer
    return ReferenceOffTracking(
        unit=watched.unit,
        follow_distance=watched.geometry.follow_distance,
        path_height=watched.path_height,
        rng=trailer_stream(parts.seed, parts.vehicle, watched.unit, "reference unit"),
    )


def _fallback(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """1 in rows in which the fallback steers the trailer, 0 in others."""
    ticks = [tick for tick, _ in trailer.handovers]
    states = np.array([0.0, *(float(by_fallback) for _, by_fallback in trailer.handovers)])
    return _in_rows(n_rows, ticks, states)


def _distrusted(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """Number of signals that the guard of a trailer's law holds to be at fault in each row."""
    findings = sorted(trailer.findings, key=lambda finding: finding.tick)
    counts = np.cumsum([0.0, *(1.0 if finding.at_fault else -1.0 for finding in findings)])
    ticks = [finding.tick for finding in findings]
    return _in_rows(n_rows, ticks, counts)


def _axles_at_fault(trailer: SteeredTrailer, n_rows: int) -> FloatArray:
    """Number of axles that do not follow their demands, as the supervision of a trailer's law holds, in each row."""
    counts, findings = np.zeros(n_rows), trailer.actuator_findings
    for axles in dict.fromkeys(finding.axles for finding in findings):
        own = [finding for finding in findings if finding.axles == axles]
        states = np.array([0.0, *(float(len(axles) * (finding.kind != "sound")) for finding in own)])
        ticks = [finding.tick for finding in own]
        counts += _in_rows(n_rows, ticks, states)
    return counts


def _in_rows(n_rows: int, ticks: Sequence[int], states: FloatArray) -> FloatArray:
    """State in each row: the first of ``states`` (n + 1,), and from each of the n ``ticks`` on the next one."""
    return states[np.searchsorted(ticks, LOG_PERIOD * np.arange(n_rows), side="right")]


def _with_record(scenario: Scenario, inputs: RunInputs, outside: Outside | None) -> tuple[Scenario, RunInputs]:
    """The scenario that repeats the demands from outside, with their record among its inputs."""
    if outside is None or not outside.record:
        return scenario, inputs
    options = scenario.outside.model_copy(update={"record": RECORD_NAME})
    files = {**inputs.files, RECORD_NAME: outside.record.encode()}
    return scenario.model_copy(update={"outside": options}), replace(inputs, files=files)


def _steer_warnings(parts: Assembly, log: Log) -> tuple[str, ...]:
    vehicle, tractor = parts.vehicle, parts.vehicle.units[0].name
    axles = [
        SteeredAxle(
            signal=signal,
            name=f"{unit.name}, axle {k}",
            limit=steering.limit * abs(axle.steer_ratio),
            rate_limit=steering.rate_limit * abs(axle.steer_ratio),
        )
        for unit, outline in zip(vehicle.units, outlines(vehicle), strict=True)
        for k, (axle, signal) in enumerate(zip(unit.axles, outline.steer_signals, strict=True), start=1)
        if signal is not None and (steering := unit.steering_of(axle)) is not None
    ]
    if f"x_{tractor}" not in log:
        return ()
    return steer_warnings(
        log, axles, parts.course.centreline, np.column_stack([log[f"x_{tractor}"], log[f"y_{tractor}"]])
    )


def _camera_warnings(session: TrailerSession) -> tuple[str, ...]:
    """Warnings about the cameras of all trailers."""
    return tuple(
        f"{trailer.trailer.name}: {line}"
        for trailer in session.trailers
        for line in calibration_warnings((e.motion for e in trailer.estimates), "set rig.self_calibration=true")
    )


def _doubts(trailer: SteeredTrailer) -> Iterable[str]:
    """Warnings about what the estimator doubts, and the law's guard does not."""
    return doubt_warnings((e.off_tracking for e in trailer.estimates), {one.signal for one in trailer.findings})


def _signal_warnings(session: TrailerSession) -> tuple[str, ...]:
    """Warnings about signals and steering actuators of all trailers."""
    return tuple(
        f"{trailer.trailer.name}{line}"
        for trailer in session.trailers
        for line in (
            *(f": {line}" for line in signal_warnings(trailer.findings)),
            *(f": {line}" for line in _doubts(trailer)),
            *(f", {line}" for line in actuator_warnings(trailer.actuator_findings)),
        )
    )


def _speed_warnings(parts: Assembly, log: Log) -> tuple[str, ...]:
    """Lines on laws outside of what they are for."""
    fastest = float(np.nanmax(log[f"v_x_{parts.vehicle.units[0].name}"], initial=0.0))
    return tuple(
        f"{trailer.name}: {line}" for trailer in parts.trailers for line in law_warnings(trailer.law.law, fastest)
    )


def _camera_frames(session: TrailerSession) -> tuple[CameraFrame, ...]:
    frames, scale = session.pictures.frames, session.pictures.scale
    shown = {tick for tick, _ in frames}
    motions = {
        estimate.motion.tick: estimate.motion
        for estimate in session.trailers[-1].estimates
        if estimate.motion and estimate.motion.tick in shown
    }
    none = lost_motion(0, 0)
    shown_by = [(tick, jpeg, motions.get(tick, none)) for tick, jpeg in frames]
    return tuple(
        CameraFrame(
            tick=tick,
            jpeg=jpeg,
            tracks=np.float32(scale) * (motion.tracks + np.float32(0.5)) - np.float32(0.5),
            matches=motion.matches,
            inliers=motion.inliers,
        )
        for tick, jpeg, motion in shown_by
    )
