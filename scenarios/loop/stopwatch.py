"""Where the time of a run goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, get_args

from scenarios.results.timing import Timing

Stage = Literal["physics", "render", "odometry", "wait", "total"]  # wait: for the odometry, which runs beside


class Stopwatch:
    """Wall time of every stage so far."""

    def __init__(self) -> None:
        self._seconds: dict[Stage, float] = dict.fromkeys(get_args(Stage), 0.0)

    @contextmanager
    def timed(self, stage: Stage) -> Iterator[None]:
        """Adds what happens inside to the stage; called from the loop's and the estimator's thread."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[stage] += time.perf_counter() - begin

    def timing(self, simulated_s: float) -> Timing:
        """The account of a run in which so much time was simulated [s]."""
        seconds = self._seconds
        return Timing(
            simulated_s=simulated_s,
            wall_s=seconds["total"],
            physics_s=seconds["physics"],
            render_s=seconds["render"],
            odometry_s=seconds["odometry"],
            odometry_beside_s=seconds["odometry"] - seconds["wait"],
        )
