"""Pilot of a combination: its driver, and its trailers with their channels and steering laws."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from typing import TypeVar

import numpy as np

from controllers.driver import DriverCommand, DriverLike
from controllers.trailer import SteerCommand
from controllers.trailer_steering.actuator_monitor import ActuatorFinding
from controllers.trailer_steering.guard import signal_findings
from controllers.trailer_steering.supervision import actuator_findings
from estimators.estimates import CameraOffTracking, OffTracking
from estimators.off_tracking.signal_monitor import Finding
from scenarios.assembly.trailer import WatchedTrailer
from scenarios.assembly.trailer_law import fallback_steers
from scenarios.hil.demands import DRIVER
from scenarios.loop.bench import Sensed, TrailerBench
from scenarios.loop.channel import Channel, Stateful
from scenarios.loop.control import CONTROL
from scenarios.loop.stopwatch import Stopwatch
from scenarios.loop_faults.applied import BrakeFaults
from scenarios.results.trailer_signals import CombinationRecord, Estimate
from sensors.instruments.navigation import DriverPerception
from sensors.sensor import Message
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
        self.demand = SteerCommand(angles=np.zeros(trailer.n_steered))
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
        return signal_findings(self._law.memory)

    @property
    def actuator_findings(self) -> tuple[ActuatorFinding, ...]:
        """Faults of the steering actuators that the law's supervision has found so far; none if a bench has steered."""
        return () if self._steered_by_bench else actuator_findings(self._law.memory)

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
        self.demand = self._law(truth.tick, self.off_tracking, self.trailer.signals.sample(truth))
        by_fallback = fallback_steers(self._law.memory)
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
