"""The closed loop of every run: sample, deliver, control, log, integrate, judge, always in this order."""

import mmap
import traceback
from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Any, Generic, Protocol, Self, TypeVar

from controllers.checked import LawError, misbehaviour
from scenarios.loop.channel import Channel, Kept, Pacer, Stopwatch, steady_python
from scenarios.progress import Progress, no_progress
from scenarios.results.log import Row
from scenarios.results.run_inputs import RunInputs
from scenarios.results.run_summary import Result
from sensors.messages import Stamped
from vehicle.clock import TICK
from vehicle.combination.plant import DivergedError
from vehicle.foundation.plant_like import EndedError, KilledError, PlantLike
from vehicle.frames import FloatArray

TruthT = TypeVar("TruthT", bound=Stamped)
TruthIn = TypeVar("TruthIn", contravariant=True)
CommandT = TypeVar("CommandT")
CommandOut = TypeVar("CommandOut", covariant=True)
RecordT = TypeVar("RecordT")
RecordOut = TypeVar("RecordOut", covariant=True)

_ROWS = 50  # are written at once: 1000 would make a paced step late
_IN_MEMORY = 5000  # rows: 50 s of some kilobytes each; writing and reading them takes as long as the judge
_RESERVE = 64_000_000  # for the results of a run that ends for lack of memory [bytes]
_SHOWN = 200  # progress of a paced run is shown after so many ticks
FAILED = "failed"  # begins the outcome of a run that an exception ended


class Pilot(Protocol[TruthIn, CommandOut, RecordOut]):
    """Drivers and controllers of a vehicle, acting on the delivered estimates."""

    def control(self, truth: TruthIn, tick: int) -> tuple[CommandOut, RecordOut]:
        """Command until the next step, and the record for the log."""


class Judge(Protocol[TruthIn]):
    """Rules that end a run."""

    @property
    def progress(self) -> float:
        """Share of the course that is done, 0 to 1."""

    def outcome(self, truth: TruthIn) -> str | None:
        """Outcome of the run; None if it continues."""


class Observer(Protocol[TruthIn]):
    """A passive listener: recorders, hashes, pictures for reports, ground that keeps traces."""

    def follow(self, truth: TruthIn) -> None:
        """Receive the truth once a step, before the sensors sample."""

    def see(self, channel: int, message: object, truth: TruthIn) -> None:
        """Receive every message of a sensor; channels are numbered from 0."""


class Session(Generic[TruthT, CommandT, RecordT]):
    """A run in progress. It is mutable; its parts are pure, or model things that change."""

    def __init__(
        self,
        plant: PlantLike[TruthT, CommandT],
        state: FloatArray,
        *,
        period: int,
        pilot: Pilot[TruthT, CommandT, RecordT],
        judge: Judge[TruthT],
        channels: Sequence[Channel[TruthT, Any, Any]] = (),
        observers: Sequence[Observer[TruthT]] = (),
        stopwatch: Stopwatch | None = None,
    ) -> None:
        """Begin a run at tick 0.

        Args:
            plant: simulates the vehicle.
            state: state of the plant at the start.
            period: period of control and log, and of one integration call [ticks].
            pilot: computes the commands.
            judge: decides when the run ends.
            channels: sensors with their estimators.
            observers: receive every truth and message.
            stopwatch: measures computing time; share it with the channels.
        """
        self.tick = 0
        self.outcome: str | None = None  # None while the run continues
        self.reason = ""  # of a run that diverged, if it is known
        self.traceback = ""  # of the exception that ended the run
        self.rows: Kept[Row[TruthT, RecordT]] = Kept(_ROWS, recent=_IN_MEMORY)
        self.stopwatch = stopwatch or Stopwatch()
        self._plant, self._state, self._period = plant, state, period
        self._pilot, self._judge = pilot, judge
        self._channels, self._observers = channels, observers
        self._running: tuple[str, object] = ("plant", plant)  # kind and part that is computing, for messages

    @property
    def progress(self) -> float:
        """Share of the course that is done, 0 to 1."""
        return self._judge.progress

    @property
    def truth(self) -> TruthT:
        """Ground truth now."""
        return self._plant.observe(self._state, self.tick)

    def advance(self) -> None:
        """Run the loop once, including the integration to the next row. Exceptions of the parts pass through."""
        with self.stopwatch.timed("total"):
            self._running = ("plant", self._plant)
            with self.stopwatch.timed("physics"):
                truth = self._plant.observe(self._state, self.tick)
            for observer in self._observers:
                self._running = ("observer", observer)
                observer.follow(truth)
            for number, channel in enumerate(self._channels):
                self._running = ("sensor", channel.sensor)
                message = channel.sample(truth, self.tick)
                if message is not None:
                    for observer in self._observers:
                        self._running = ("observer", observer)
                        observer.see(number, message, truth)
            for channel in self._channels:
                self._running = ("estimator", channel.estimator)
                channel.deliver(self.tick)
            self._running = ("pilot", self._pilot)
            command, record = self._pilot.control(truth, self.tick)
            self.rows.append(Row(truth, record))
            self._running = ("plant", self._plant)
            self._integrate(command)
            self._running = ("judge", self._judge)
            self.outcome = self._judge.outcome(truth) if self.outcome is None else self.outcome

    def run_paced(self, pacer: Pacer, progress: Progress = no_progress) -> None:
        """Run as ``run``, every step at its time on the clock; only the times differ, not the results."""

        def paced(done: float, total: float, note: str = "", /) -> None:
            pacer.end(self.tick, self.stopwatch.seconds("wait"))
            if self.tick % _SHOWN == 0:
                progress(done, total, note)
            if self.outcome is None:
                pacer.begin(self.tick, self.stopwatch.seconds("wait"))

        with steady_python():
            try:
                pacer.begin(self.tick, self.stopwatch.seconds("wait"))
            except KeyboardInterrupt:
                self.outcome = "interrupted"
            self.run(paced)

    def run(self, progress: Progress = no_progress) -> None:
        """Advance until there is an outcome; an interrupt is one, and so is an exception of any part."""
        reserve = mmap.mmap(-1, _RESERVE)  # pages that nobody touches take no memory
        try:
            while self.outcome is None:
                self._advance_or_fail()
                progress(self.progress, 1.0, f"{self.tick * TICK:.1f} s simulated")
        except KeyboardInterrupt:
            self.outcome = "interrupted"
        except MemoryError:
            reserve.close()
            self._fail(MemoryError(f"not enough memory after {self.tick * TICK:.1f} s"))

    def _advance_or_fail(self) -> None:
        try:
            self.advance()
        except (LawError, KilledError) as error:
            self._fail(error)
        except EndedError as error:
            self.outcome, self.reason = "diverged", str(error)
        except (Exception, SystemExit) as error:  # parts may be a user's own, and may do anything
            kind, part = self._running
            part = getattr(part, "wrapped", part)  # of a part that watches over a user's, the user's
            event = f"raised {type(error).__name__}: {error}"
            self._fail(misbehaviour(f"{kind} {type(part).__name__}", self.tick, event, part, error))

    def _fail(self, line: Exception) -> None:
        self.outcome, self.traceback = f"{FAILED}: {line}", traceback.format_exc()

    def _integrate(self, command: CommandT) -> None:
        try:
            with self.stopwatch.timed("physics"):
                self._state = self._plant.step(self._state, command, self._period)
        except DivergedError:
            self.outcome = "diverged"
        self.tick += self._period


class RunSession(Session[TruthT, CommandT, RecordT], ABC):
    """The run of a scenario: a session of parts that have been assembled, with an estimator's thread and a result."""

    parts: Any  # of the run, as its kind of vehicle assembles them
    worker: Executor  # runs the estimators

    @property
    @abstractmethod
    def estimate(self) -> Any:
        """The estimate delivered last; None before the first one."""

    @abstractmethod
    def result(self, inputs: RunInputs, *, complete: bool = True) -> Result:
        """The result as far as the run has come; one that is not ``complete`` lacks what takes long to compute."""

    def close(self) -> None:
        """End the estimator's thread; delivered estimates stay."""
        self.worker.shutdown(cancel_futures=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
