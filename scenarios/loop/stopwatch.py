"""Stopwatch for the stages of a run."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager
from typing import Literal, get_args

from scenarios.results.timing import Timing

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
