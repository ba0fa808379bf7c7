"""A channel of the loop: a sensor, its schedule, its messages in flight, and the estimator that receives them.

An estimate depends only on the messages before it. The estimator therefore runs in a worker thread between the capture
of a message and its delivery, while the loop continues on another core. Cameras of a paced run are rendered between
the two as well, by a thread of their own. The results are bitwise the same as in line.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import partial
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, runtime_checkable

from controllers.checked import LawError, misbehaviour
from estimators.context import Estimator
from estimators.estimates import check_estimate
from scenarios.loop.kept import Kept
from scenarios.loop.timing import Stopwatch
from sensors.messages import Message, Sensor, Stamped
from vehicle.clock import Pipe, Schedule

_DELIVERED = 20  # estimates in memory; twice as many at most
TruthT = TypeVar("TruthT", bound=Stamped)
MessageT = TypeVar("MessageT", bound=Message)
EstimateT = TypeVar("EstimateT")
MemoryT = TypeVar("MemoryT")
P = ParamSpec("P")
R = TypeVar("R")


@runtime_checkable
class TwoPart(Protocol):
    """A sensor whose sample has a part that must be done in the loop, and one that may be done later."""

    def begin(self, truth: Any, /) -> Callable[[], Any] | None:
        """Do the first part; the returned function does the second. None: nothing is sent at this tick."""


class Channel(Generic[TruthT, MessageT, EstimateT]):
    """One sensor with the estimator behind it; without an estimator it only captures messages."""

    def __init__(
        self,
        sensor: Sensor[TruthT, MessageT],
        schedule: Schedule,
        estimator: Estimator[MemoryT, MessageT, EstimateT] | None,
        worker: Executor,
        stopwatch: Stopwatch,
        *kinds: type[EstimateT],
        renderer: Executor | None = None,
        see: Callable[[MessageT, TruthT], None] | None = None,
    ) -> None:
        """Create a channel before its first sample.

        Args:
            sensor: is sampled.
            schedule: when it is sampled, and how long its messages travel.
            estimator: receives the messages.
            worker: runs the estimator.
            stopwatch: accounts for the time of sensor and estimator.
            kinds: classes of the estimates, which are checked; none: they are not.
            renderer: samples the sensor, one message after the other; None: the loop does.
            see: receives the messages that ``renderer`` samples.
        """
        self.schedule = schedule
        self.sensor, self.estimator = sensor, estimator
        self.delivered: Kept[EstimateT] = Kept(_DELIVERED)  # oldest first
        self._worker, self._stopwatch, self._kinds = worker, stopwatch, kinds
        self._estimate = None if estimator is None else Stateful(estimator.init(), estimator.step)
        self._in_flight: Pipe[Future[EstimateT | None]] = Pipe()
        self._renderer, self._see = renderer, see
        self._unseen: LawError | None = None  # what went wrong with a picture in the renderer's thread

    @property
    def newest(self) -> EstimateT | None:
        """The estimate delivered last."""
        return self.delivered[-1] if self.delivered else None

    def sample(self, truth: TruthT, tick: int) -> MessageT | None:
        """Sample the sensor if it is due, and send the message to the estimator; None if a renderer samples it."""
        if not self.schedule.due(tick):
            return None
        if self._renderer is not None:
            self._sample_aside(self._renderer, truth, tick)
            return None
        with self._stopwatch.timed("render"):
            message = self.sensor.sample(truth)
        if message is not None and self._estimate is not None:
            estimate = self._worker.submit(self._timed, self._estimate, message)
            self._in_flight = self._in_flight.put(tick + self.schedule.latency, estimate)
        return message

    def _sample_aside(self, renderer: Executor, truth: TruthT, tick: int) -> None:
        """Let the renderer sample the sensor and send the message on; the loop waits for it at its delivery."""
        sensor: object = self.sensor
        rest = sensor.begin(truth) if isinstance(sensor, TwoPart) else partial(self.sensor.sample, truth)
        if rest is None:
            return
        promised: Future[EstimateT | None] = Future()
        self._in_flight = self._in_flight.put(tick + self.schedule.latency, promised)
        renderer.submit(self._rendered, rest, truth, promised)

    def _rendered(self, rest: Callable[[], MessageT | None], truth: TruthT, promised: Future[EstimateT | None]) -> None:
        try:
            with self._stopwatch.timed("render"):
                message = rest()
        except Exception as error:  # of a user's sensor: of any kind
            promised.set_exception(self._misbehaviour(truth.tick, error))
            return
        if message is None or self._estimate is None:
            promised.set_result(None)
        else:
            self._worker.submit(self._keep_promise, self._estimate, message, promised)
        if message is not None and self._see is not None:  # now: pictures must not keep the estimate waiting
            try:
                self._see(message, truth)
            except Exception as error:
                self._unseen = self._misbehaviour(truth.tick, error)

    def _misbehaviour(self, tick: int, error: Exception) -> LawError:
        event, name = f"raised {type(error).__name__}: {error}", f"sensor {type(self.sensor).__name__}"
        return misbehaviour(name, tick, event, self.sensor, error)

    def _keep_promise(
        self,
        estimate: Callable[[MessageT], EstimateT | None],
        message: MessageT,
        promised: Future[EstimateT | None],
    ) -> None:
        try:
            promised.set_result(self._timed(estimate, message))
        except BaseException as error:
            promised.set_exception(error)

    def deliver(self, tick: int) -> None:
        """Receive the estimates that are due by this tick.

        Raises:
            TypeError: one line, if the estimator returned something else.
            LawError: one line, if a picture could not be taken, or not be recorded, in the renderer's thread.
        """
        if self._unseen is not None:
            raise self._unseen
        self._in_flight, due = self._in_flight.deliver(tick)
        for future in due:
            with self._stopwatch.timed("wait"):
                estimate = future.result()
            if estimate is not None:
                if self._kinds:
                    check_estimate(estimate, self._kinds)
                self.delivered.append(estimate)

    def _timed(self, estimate: Callable[[MessageT], EstimateT | None], message: MessageT) -> EstimateT | None:
        with self._stopwatch.timed("odometry"):
            return estimate(message)


class Stateful(Generic[MemoryT, P, R]):
    """A pure step as a function that carries the memory from call to call."""

    def __init__(self, memory: MemoryT, step: Callable[Concatenate[MemoryT, P], tuple[MemoryT, R]]) -> None:
        self.memory: MemoryT = memory
        self._step = step

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Output of the next step."""
        self.memory, output = self._step(self.memory, *args, **kwargs)
        return output


def estimator_thread() -> Executor:
    """A thread for the estimators of a run; one alone, so that messages stay in order."""
    return ThreadPoolExecutor(max_workers=1, thread_name_prefix="estimator")


class InLine(Executor):
    """Executor that runs each call at once in the calling thread."""

    def submit(self, call: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Future with the result of the call."""
        return Finished(call(*args, **kwargs))


class Finished(Future[R]):
    """The future of a call that is over; it can be copied."""

    def __init__(self, result: R) -> None:
        super().__init__()
        self.set_result(result)

    def __reduce__(self) -> tuple[Any, ...]:
        return (Finished, (self.result(),))
