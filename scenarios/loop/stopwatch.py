"""Stopwatch for the stages of a run."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, get_args

from scenarios.results.timing import Timing

Stage = Literal["physics", "render", "odometry", "wait", "total"]  # wait: for the odometry's thread


class Stopwatch:
    """Wall time of every stage so far."""

    def __init__(self) -> None:
        self._seconds: dict[Stage, float] = dict.fromkeys(get_args(Stage), 0.0)

    @contextmanager
    def timed(self, stage: Stage) -> Iterator[None]:
        """Add the time spent inside to the stage; the loop and the estimator's thread call this."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[stage] += time.perf_counter() - begin

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
