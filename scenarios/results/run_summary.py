"""Result and summary of a run of any kind of vehicle: computing time, pace, demands, and the manifest."""

import importlib.metadata
import math
import platform
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import cv2

from scenarios.results.log import Log
from scenarios.results.run_inputs import RunInputs, manifest_entry
from vehicle.engine.compiler import engine_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Computing time of a run by stage [s]."""

    simulated_s: float
    wall_s: float
    physics_s: float
    render_s: float
    odometry_s: float
    odometry_parallel_s: float = 0.0  # part of it that ran in parallel to other stages and cost no wall time

    @property
    def rest_s(self) -> float:
        """Wall time outside the three stages: controllers, bookkeeping, log [s]."""
        waited = self.odometry_s - self.odometry_parallel_s
        return max(0.0, self.wall_s - self.physics_s - self.render_s - waited)

    @property
    def realtime_factor(self) -> float:
        """Simulated time over wall time: above 1 the run was faster than reality."""
        return self.simulated_s / self.wall_s if self.wall_s > 0.0 else math.nan


Numbers = dict[str, float | int | None]
Summary = dict[str, str | int | list[str] | Numbers | dict[str, Numbers]]


def number(value: float) -> float | None:
    """The value rounded to six decimals; None if it is not finite."""
    return round(float(value), 6) if math.isfinite(value) else None


def number_at(summary: Mapping[str, Any], path: str) -> float | None:
    """The number ``group.name`` of a summary; None if there is none, or something else."""
    value: Any = summary
    for part in path.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def timing_numbers(timing: Timing) -> Numbers:
    """The group ``timing`` of a summary."""
    names = ("simulated_s", "wall_s", "realtime_factor", "physics_s", "render_s", "odometry_s")
    return {name: number(getattr(timing, name)) for name in names}


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Outside:
    """Signals sent and demands received. Steps are counted once for every part that is steered from outside."""

    source: str  # "udp", "can", "udp, can", "record"; empty: no demands are taken
    sent: int  # signals, once a step of control
    received: int  # messages with demands
    refused: int  # messages that can't be read or that break a limit
    first_refusal: str  # why, of the first of them; empty: there is none
    fresh_steps: int  # in which a demand came
    held_steps: int  # in which none came, and the last one held
    fallback_steps: int  # in which it was too old, or there was none yet
    longest_gap_s: float  # between two demands of a part [s]
    record: str  # the demands as CSV; empty: none are taken, or they came from a record

    @property
    def reproducible(self) -> bool:
        """True if scenario and seed decide the results."""
        return self.source in ("", "record")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines about demands that came from outside, that failed, and that were refused."""
        lines = []
        if not self.reproducible:
            lines.append(
                f"demands came from outside by {self.source}: another run has others; scenario.toml of this run's "
                "directory repeats those that came, bitwise"
            )
        if self.source and self.fallback_steps:
            lines.append(f"demands from outside lacked in {self.fallback_steps} steps: the scenario's own part acted")
        if self.refused:
            lines.append(f"{self.refused} messages from outside were refused; the first one {self.first_refusal}")
        return tuple(lines)

    def numbers(self) -> Numbers:
        """The group ``outside`` of a summary."""
        return {
            "reproducible": self.reproducible,
            "signals_sent": self.sent,
            "demands_received": self.received,
            "messages_refused": self.refused,
            "fresh_steps": self.fresh_steps,
            "held_steps": self.held_steps,
            "fallback_steps": self.fallback_steps,
            "longest_gap_s": number(self.longest_gap_s),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result(ABC):
    """The result of a run."""

    kind: ClassVar[str]  # of its vehicle: the ``vehicle_kind`` of its scenario

    scenario: str  # name
    scenario_toml: str  # resolved: runs again identically
    seed: int
    outcome: str  # "completed", "diverged", "failed: …", …
    log: Log
    timing: Timing
    manifest: Mapping[str, str]  # what identifies the run besides seed and signals, such as the hash of its images
    traceback: str = ""  # of the exception that ended the run
    warnings: tuple[str, ...] = ()  # of what is doubtful about the run, a line each
    inputs: RunInputs = field(default_factory=RunInputs)  # files and own modules that the scenario names
    paced: Paced | None = None  # deadlines kept and missed; None: the run was not paced
    placement: Mapping[str, str | float] = field(default_factory=dict)  # of W in the coordinates of the course's file

    def all_warnings(self) -> tuple[str, ...]:
        """Lines about what is doubtful: of the run itself, and of its pace."""
        return (*self.warnings, *(self.paced.warnings if self.paced else ()))

    @abstractmethod
    def summary(self) -> Summary:
        """The run in numbers, ready for JSON: null stands for numbers that do not apply or were not measured."""


def manifest(result: Result) -> dict[str, object]:
    """Versions and hashes that identify the run."""
    return {
        "scenario": result.scenario,
        "seed": result.seed,
        "versions": versions(),
        "signals_sha256": result.log.sha256(),
        **result.manifest,
        **({"placement": dict(result.placement)} if result.placement else {}),
        **manifest_entry(result.inputs),
    }


def versions() -> dict[str, str]:
    """Versions of the software that determines a run's numbers, and the engine of its vehicle model."""
    installed = {name: importlib.metadata.version(name) for name in ("offtrack", "numpy", "casadi")}
    return {"python": platform.python_version(), **installed, "opencv": cv2.__version__, "engine": engine_name()}
