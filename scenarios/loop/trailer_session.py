"""The closed-loop run of a combination: its driver, its steered trailers, and their session."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from functools import partial
from typing import TypeVar

import numpy as np

from controllers.driver import DriverCommand, DriverLike
from controllers.trailer import SteerCommand
from controllers.trailer_steering.actuators import ActuatorFinding
from controllers.trailer_steering.safeguarded import SafeguardedCommand
from estimators.estimates import CameraOffTracking, OffTracking
from estimators.off_tracking.signal_monitor import Finding
from offtrack.exchange.recordings.writers import RecordingWriter
from scenarios.assembly.applied_faults import BrakeFaults
from scenarios.assembly.trailer_run import LOG_PERIOD, Assembly, WatchedTrailer
from scenarios.loop.bench import Sensed, TrailerBench, opened_bench
from scenarios.loop.channel import Channel, Stateful, estimator_thread
from scenarios.loop.demands import DRIVER, Link
from scenarios.loop.image_observers import StereoPictures
from scenarios.loop.referee import CourseJudge
from scenarios.loop.session import Session
from scenarios.loop.timing import CONTROL, Stopwatch
from scenarios.results.trailer_signals import CombinationRecord, Estimate
from sensors.instruments.navigation import DriverPerception
from sensors.messages import Message
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
    def newest(self) -> Estimate | None:
        """The estimate delivered last."""
        return None if self.channel.newest is None else as_estimate(self.channel.newest)

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
        sent = self.channel.delivered[self._received :]
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
        bench: TrailerBench | None = None,
        brakes: BrakeFaults | None = None,
    ) -> None:
        """Create the pilot of a ``vehicle``; without a driver its motion is prescribed.

        Demands of the ``bench`` come before those of driver and laws. ``brakes`` are the faults of its brakes.
        """
        self.trailers = trailers
        self._bench, self._brakes = bench, brakes or BrakeFaults()
        self._driver = None if driver is None else Stateful(driver.init(), driver.step)
        self._driver_demand = DriverCommand(steer=0.0, acceleration=0.0)
        self._of_tractor = len(vehicle.units[0].steered_axles)
        self._n_trailer_axles = sum(len(unit.steered_axles) for unit in vehicle.units[1:])

    def control(self, truth: Truth, tick: int) -> tuple[VehicleCommand, CombinationRecord]:
        """Command of this step."""
        for trailer in self.trailers:
            trailer.receive(tick)
        due = CONTROL.due(tick)
        if due:
            if self._driver:
                self._driver_demand = self._driver(tick, DriverPerception().sample(truth))
            for trailer in self.trailers:
                trailer.control(truth)
            if self._bench:
                self._obey(self._bench, truth)
        demand = self._driver_demand
        steer = self._trailer_steer(truth, is_new=due)
        command = VehicleCommand(demand.steer, demand.acceleration, steer, demand.gear, self._brakes.shares(tick))
        return command, CombinationRecord(demand, tuple(trailer.demand for trailer in self.trailers))

    def _obey(self, bench: TrailerBench, truth: Truth) -> None:
        """Send the signals of this step, and take the demands of the bench."""
        sensed = [
            Sensed(one.trailer.name, one.off_tracking, one.trailer.signals.sample(truth)) for one in self.trailers
        ]
        demands = bench.step(truth.tick, DriverPerception().sample(truth), sensed)
        for trailer in self.trailers:
            if trailer.trailer.name in demands:
                trailer.obey(np.array(demands[trailer.trailer.name]))
        if DRIVER in demands:
            self._driver_demand = DriverCommand(*demands[DRIVER])

    def _trailer_steer(self, truth: Truth, *, is_new: bool) -> tuple[float, ...]:
        """Demands for every steered trailer axle [rad]; axles of trailers that are not watched stay straight."""
        angles = np.zeros(self._n_trailer_axles)
        for trailer in self.trailers:
            first = trailer.trailer.steers_ahead - self._of_tractor
            angles[first : first + trailer.trailer.n_steered] = trailer.actuate(truth, is_new=is_new)
        return tuple(angles.tolist())


def as_estimate(delivered: OffTrackingEstimate) -> Estimate:
    """A delivered estimate with the camera motion behind it, if there is one."""
    if isinstance(delivered, CameraOffTracking):
        return Estimate(delivered.off_tracking, delivered.motion)
    return Estimate(delivered)


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
