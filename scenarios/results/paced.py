"""How well a paced run kept wall time."""

from __future__ import annotations

from dataclasses import dataclass

from scenarios.results.numbers import Numbers, number

_TOLERATED = 0.01  # share of late steps without a warning


@dataclass(frozen=True, slots=True, kw_only=True)
class Paced:
    """Deadlines of a paced run: every step should end before the next one begins on the clock."""

    speed: float  # wanted simulated time over wall time [-]
    step_s: float  # wall time of a step: its limit [s]
    steps: int
    misses: int  # steps that ended late
    worst_s: float  # latest end of a step after its deadline [s]
    behind_s: float  # of the last step [s]
    longest_step_s: float  # longest computing time of a step [s]
    longest_wait_s: float  # longest time in it that the loop waited for cameras and odometry [s]
    busy_s: float  # computing time of all steps, with waiting for cameras and odometry [s]
    simulated_s: float

    @property
    def misses_share(self) -> float:
        """Share of the steps that ended late."""
        return self.misses / self.steps if self.steps else 0.0

    @property
    def best_speed(self) -> float:
        """Speed at which the steps would have filled all wall time, by their mean computing time."""
        return self.simulated_s / self.busy_s if self.busy_s > 0.0 else self.speed

    @property
    def warnings(self) -> tuple[str, ...]:
        """A line, if more than 1 % of the steps ended late."""
        if self.misses_share <= _TOLERATED:
            return ()
        cause = "waiting for cameras and odometry" if self.longest_wait_s > 0.5 * self.longest_step_s else "the loop"
        slower = min(0.8 * self.best_speed, 0.8 * self.speed)
        return (
            f"paced: {100.0 * self.misses_share:.1f} % of the steps ended after their {1e3 * self.step_s:.3g} ms, by "
            f"{1e3 * self.worst_s:.0f} ms at worst, mostly {cause}; try --speed {slower:.2g}",
        )

    def numbers(self) -> Numbers:
        """The group ``paced`` of a summary."""
        return {
            "speed": number(self.speed),
            "step_ms": number(1e3 * self.step_s),
            "steps": self.steps,
            "misses": self.misses,
            "misses_share": number(self.misses_share),
            "worst_ms": number(1e3 * self.worst_s),
            "behind_ms": number(1e3 * self.behind_s),
            "longest_step_ms": number(1e3 * self.longest_step_s),
            "longest_wait_ms": number(1e3 * self.longest_wait_s),
            "best_speed": number(self.best_speed),
        }
