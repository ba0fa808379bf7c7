"""Time in the loop: schedule of the controllers, pace of the wall clock, and stopwatch of the stages."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Final, Literal, get_args

from controllers.driver import PERIOD
from scenarios.results.summary_numbers import Paced, Timing
from vehicle.clock import TICK, Schedule, to_ticks

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
