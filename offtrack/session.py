"""A run that is stepped by hand, looked at, and copied."""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import TracebackType
from typing import Any

from estimators.estimates import OffTracking, SlipAngle
from offtrack.runs import Run, checked_seed, load
from scenarios.loop.channel import InLine
from scenarios.loop.runner import KINDS
from scenarios.results.run_inputs import run_inputs
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.rover.truth import RoverTruth


class Session:
    """A run in steps: look at it between them, go on, or copy it to try something else.

    ``copy.deepcopy`` gives a snapshot that goes on bitwise like the original. Snapshots share the renderer of the
    cameras, so close a session only when its snapshots are done.
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str],
        *,
        seed: int = 1,
        settings: Mapping[str, Any] | None = None,
        **keys: Any,
    ) -> None:
        """Begin a run at time 0. The arguments are those of `offtrack.run`.

        Raises:
            TypeError: one line, if an argument is of another type.
            ValueError: one line that names key, value and limit.
        """
        chosen = load(scenario, settings, keys)
        kind, seed = KINDS[chosen.vehicle_kind], checked_seed(seed)
        self._inputs = run_inputs(chosen.model_dump(exclude_none=True))
        self._session = kind.session(kind.assemble(chosen, seed), worker=InLine())

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._session.tick * TICK

    @property
    def outcome(self) -> str | None:
        """How the run has ended; None while it continues."""
        return self._session.outcome

    @property
    def truth(self) -> Truth | RoverTruth:
        """Ground truth now, as the log has it: poses, velocities, wheel loads."""
        truth: Truth | RoverTruth = self._session.truth
        return truth

    @property
    def estimate(self) -> OffTracking | SlipAngle | None:
        """The estimate delivered last: off-tracking of the last trailer, or slip angle of the rover."""
        estimate: OffTracking | SlipAngle | None = self._session.estimate
        return estimate

    def step(self, duration: float | None = None) -> bool:
        """Go on for ``duration`` [s], by default for one step of the loop; return True while the run continues.

        Raises:
            ValueError: if the duration is not positive.
        """
        if duration is not None and not duration > 0.0:
            raise ValueError(f"duration = {duration} s must be positive")
        end = self.time + (duration or 0.0)
        while self.outcome is None:
            self._session.advance()
            if self.time >= end - 0.5 * TICK:
                break
        return self.outcome is None

    def run(self) -> Run:
        """Go on to the end, and return the run."""
        self._session.run()
        return self.result()

    def result(self) -> Run:
        """The run as far as it has come; its outcome is then "unfinished"."""
        result = self._session.result(self._inputs)
        return Run(result.summary(), result.log, None, result)

    def close(self) -> None:
        """Free the renderer of the cameras, and end the processes of FMUs."""
        self._session.close()
        self._session.parts.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()
