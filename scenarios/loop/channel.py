"""A sensor's channel with its estimator, rows kept on disk, and time in the loop: control schedule, pace, stopwatch.

An estimate depends only on the messages before it. The estimator therefore runs in a worker thread between the capture
of a message and its delivery, while the loop continues on another core. A trailer's cameras are rendered between the
two as well, by a thread of their own. The results are bitwise the same as in line.
"""

import gc
import os
import pickle
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from io import FileIO
from threading import Lock
from typing import (
    Any,
    Concatenate,
    Final,
    Generic,
    Literal,
    NamedTuple,
    ParamSpec,
    Protocol,
    TypeVar,
    cast,
    get_args,
    overload,
    runtime_checkable,
)

from controllers.checked import LawError, misbehaviour
from controllers.driver import PERIOD
from estimators.context import Estimator
from estimators.estimates import check_estimate
from scenarios.results.run_summary import Paced, Timing
from sensors.messages import Message, Sensor, Stamped
from vehicle.clock import TICK, Pipe, Schedule, to_ticks

# Python hands its lock on to another thread after this time. Its default of 5 ms, twice, is a whole step.
_SWITCH: Final = 5e-4  # [s]


class Pacer:
    """Clock of a paced run.

    Simulated time is bound to the clock once, at the first step. A run that has fallen behind therefore catches up
    where it can, and does not stretch the rest.
    """

    def __init__(
        self,
        speed: float = 1.0,
        *,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Create a pacer.

        Args:
            speed: simulated time over wall time.
            clock: wall time [s].
            sleep: waits for a time [s].
        """
        self.speed = speed
        self._clock, self._sleep = clock, sleep
        self._origin: float | None = None  # wall time of tick 0
        self._begun = self._waited = 0.0
        self._first = self._last = 0  # ticks
        self._steps = self._misses = 0
        self._worst = self._behind = self._longest = self._longest_wait = self._busy = 0.0

    def begin(self, tick: int, waited: float) -> None:
        """Wait for the time of this tick; ``waited`` is the time that the run has waited for estimates so far [s]."""
        now = self._clock()
        if self._origin is None:
            self._origin, self._first = now - self._duration(tick), tick
        due = self._origin + self._duration(tick)
        while now < due:
            self._sleep(due - now)
            now = self._clock()
        self._begun, self._waited = now, waited

    def end(self, tick: int, waited: float) -> None:
        """Note that the step before this tick has ended."""
        assert self._origin is not None
        now = self._clock()
        spent = now - self._begun
        self._behind = max(0.0, now - self._origin - self._duration(tick))
        self._steps += 1
        self._misses += self._behind > 0.0
        self._worst, self._longest = max(self._worst, self._behind), max(self._longest, spent)
        self._longest_wait = max(self._longest_wait, waited - self._waited)
        self._busy += spent
        self._last = tick

    def report(self) -> Paced:
        """Deadlines kept and missed so far."""
        simulated = (self._last - self._first) * TICK
        return Paced(
            speed=self.speed,
            step_s=simulated / self._steps / self.speed if self._steps else 0.0,
            steps=self._steps,
            misses=self._misses,
            worst_s=self._worst,
            behind_s=self._behind,
            longest_step_s=self._longest,
            longest_wait_s=self._longest_wait,
            busy_s=self._busy,
            simulated_s=simulated,
        )

    def _duration(self, ticks: int) -> float:
        """Wall time of simulated ticks [s]."""
        return ticks * TICK / self.speed


@contextmanager
def steady_python() -> Iterator[None]:
    """Keep Python's own pauses short: threads take turns quickly, and no search for garbage interrupts.

    What refers to itself in a circle is freed after the block; a run makes little of it.
    """
    interval, collects = sys.getswitchinterval(), gc.isenabled()
    sys.setswitchinterval(_SWITCH)
    gc.disable()
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        if collects:
            gc.enable()


Stage = Literal["physics", "render", "odometry", "wait", "total"]  # wait: for the odometry's thread


class _Timed(AbstractContextManager[None]):
    """Adds the time spent inside; a generator would take four times as long, and the loop opens four a step."""

    __slots__ = ("_begin", "_seconds", "_stage")

    def __init__(self, seconds: dict[Stage, float], stage: Stage) -> None:
        self._seconds, self._stage, self._begin = seconds, stage, 0.0

    def __enter__(self) -> None:
        self._begin = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds[self._stage] += time.perf_counter() - self._begin


class Stopwatch:
    """Wall time of every stage so far."""

    def __init__(self) -> None:
        self._seconds: dict[Stage, float] = dict.fromkeys(get_args(Stage), 0.0)

    def timed(self, stage: Stage) -> AbstractContextManager[None]:
        """Add the time spent inside to the stage; the loop and the estimator's thread call this."""
        return _Timed(self._seconds, stage)

    def seconds(self, stage: Stage) -> float:
        """Wall time of a stage so far [s]."""
        return self._seconds[stage]

    def timing(self, simulated_s: float) -> Timing:
        """Computing time by stage of a run that simulated this time [s]."""
        seconds = self._seconds
        return Timing(
            simulated_s=simulated_s,
            wall_s=seconds["total"],
            physics_s=seconds["physics"],
            render_s=seconds["render"],
            odometry_s=seconds["odometry"],
            odometry_parallel_s=seconds["odometry"] - seconds["wait"],
        )


CONTROL: Final = Schedule(period=to_ticks(PERIOD, "control period"))


ItemT = TypeVar("ItemT")


class _File(FileIO):
    """A temporary file without a name; it goes with its last user."""

    def __init__(self) -> None:
        descriptor, name = tempfile.mkstemp(prefix="offtrack-")
        os.unlink(name)
        super().__init__(descriptor, "r+")

    def __del__(self) -> None:
        self.close()


class _Stored(NamedTuple):
    """A chunk in a file."""

    file: _File
    offset: int
    size: int

    def load(self) -> list[Any]:
        return cast("list[Any]", pickle.loads(os.pread(self.file.fileno(), self.size, self.offset)))


class Kept(Sequence[ItemT], Generic[ItemT]):
    """A growing sequence whose memory does not grow: an hour has 360 000 rows of some kilobytes each.

    Items must not be changed. Those that can not be pickled stay in memory, and so do all if there is no room on disk.
    Copies share what is in the file. A thread may get single items while another one appends.
    """

    def __init__(self, chunk: int, items: Iterable[ItemT] = (), *, recent: int = 0) -> None:
        """A sequence of ``items`` with the newest in memory: ``recent`` and one to two times ``chunk``."""
        self._chunk, self._recent = chunk, recent
        self._older: list[_Stored | list[ItemT]] = []  # of one chunk each
        self._newest: list[ItemT] = []
        self._file: _File | None = None
        self._lock = Lock()  # while items change their place
        for item in items:
            self.append(item)

    def append(self, item: ItemT) -> None:
        """Add an item."""
        self._newest.append(item)
        if len(self._newest) >= self._recent + 2 * self._chunk:
            oldest = self._stored(self._newest[: self._chunk])
            with self._lock:
                del self._newest[: self._chunk]
                self._older.append(oldest)

    def __len__(self) -> int:
        return self._chunk * len(self._older) + len(self._newest)

    def __iter__(self) -> Iterator[ItemT]:
        for chunk in list(self._older):
            yield from _items(chunk)
        yield from self._newest

    @overload
    def __getitem__(self, index: int) -> ItemT: ...
    @overload
    def __getitem__(self, index: slice) -> list[ItemT]: ...
    def __getitem__(self, index: int | slice) -> ItemT | list[ItemT]:
        if isinstance(index, slice):
            opened: dict[int, list[ItemT]] = {}  # chunks, each read once
            return [self._at(place, opened) for place in range(len(self))[index]]
        with self._lock:
            place = index + len(self) if index < 0 else index
            if not 0 <= place < len(self):
                raise IndexError(index)
            return self._at(place, {})

    def _at(self, place: int, opened: dict[int, list[ItemT]]) -> ItemT:
        chunk, rest = divmod(place, self._chunk)
        if chunk >= len(self._older):
            return self._newest[place - self._chunk * len(self._older)]
        if chunk not in opened:
            opened[chunk] = _items(self._older[chunk])
        return opened[chunk][rest]

    def __deepcopy__(self, _: object) -> "Kept[ItemT]":
        copied = Kept[ItemT](self._chunk, recent=self._recent)
        copied._older, copied._newest = list(self._older), list(self._newest)
        return copied

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(Kept, recent=self._recent), (self._chunk, list(self))

    def _stored(self, items: list[ItemT]) -> _Stored | list[ItemT]:
        try:
            content = pickle.dumps(items, protocol=pickle.HIGHEST_PROTOCOL)
            self._file = self._file or _File()
            offset = self._file.seek(0, os.SEEK_END)
            if self._file.write(content) < len(content):
                return items
            return _Stored(self._file, offset, len(content))
        except Exception:  # of a user's class, which may do anything; or no room is left
            return items


def _items(chunk: _Stored | list[ItemT]) -> list[ItemT]:
    return chunk.load() if isinstance(chunk, _Stored) else chunk


_DELIVERED, _RECENT = 20, 500  # estimates that are written at once, and estimates in memory: of some 20 kilobytes each
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
        self.delivered: Kept[EstimateT] = Kept(_DELIVERED, recent=_RECENT)  # oldest first
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
