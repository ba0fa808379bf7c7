"""Assessment of a combination: all standard manoeuvres, driven on several cores, compared with the standards."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from scenarios.processes import as_finished, default_jobs
from scenarios.progress import Progress, no_progress
from scenarios.standards.lane_change import lane_change
from scenarios.standards.levels import Judgement, judged
from scenarios.standards.low_speed import roundabout, turn
from scenarios.standards.manoeuvre import Figures, Manoeuvre
from scenarios.standards.pulse import pulse
from scenarios.standards.straight import straight
from scenarios.standards.theory import linear_figures
from scenarios.standards.tilt import tilt
from vehicle.combination.description import Vehicle

MANOEUVRES: Final = ("turn", "roundabout", "lane_change", "straight", "pulse", "tilt")  # in the order of the report
_LONGEST_FIRST: Final = ("roundabout", "lane_change", "turn", "straight", "tilt", "pulse")
_DRIVEN: Final = {
    "turn": turn,
    "roundabout": roundabout,
    "lane_change": lane_change,
    "straight": straight,
    "pulse": pulse,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessment:
    """A combination in all standard manoeuvres."""

    vehicle: Vehicle
    trailer_steering: str
    manoeuvres: tuple[Manoeuvre, ...]
    linear: Figures  # by linear theory, where it applies

    @property
    def figures(self) -> Figures:
        """All measured quantities by name."""
        return {name: value for manoeuvre in self.manoeuvres for name, value in manoeuvre.figures.items()}

    @property
    def judgements(self) -> tuple[Judgement, ...]:
        """All criteria of the standards that apply, compared with the measured quantities."""
        applicable = {
            name: value
            for manoeuvre in self.manoeuvres
            for name, value in manoeuvre.figures.items()
            if math.isfinite(value) or manoeuvre.outcome != "completed"
        }
        return judged(applicable)

    def summary(self) -> dict[str, Any]:
        """The assessment for JSON; null where a quantity could not be measured."""
        return {
            "vehicle": self.vehicle.name,
            "trailer_steering": self.trailer_steering,
            "manoeuvres": {
                manoeuvre.key: {"outcome": manoeuvre.outcome, **_finite(manoeuvre.figures)}
                for manoeuvre in self.manoeuvres
            },
            "linear_theory": _finite(self.linear),
            "levels": [_judgement(judgement) for judgement in self.judgements],
        }


def assess(
    vehicle: Vehicle, *, trailer_steering: str = "none", progress: Progress = no_progress, processes: int | None = None
) -> Assessment:
    """Drive a combination through every standard manoeuvre.

    Args:
        vehicle: the combination, laden as in its file.
        trailer_steering: law for the last unit's steered axles, fed with the exact off-tracking; "none" keeps them
            straight.
        progress: callback with the number of finished manoeuvres and the title of the last one.
        processes: number of processes; by default one per core.

    Raises:
        ValueError: one line, if the vehicle has no axles for the law to steer, or can not be driven.
    """
    done: dict[str, Manoeuvre] = {}
    progress(0, len(MANOEUVRES))
    tasks = [(key, vehicle, trailer_steering) for key in _LONGEST_FIRST]
    for _, manoeuvre in as_finished(_driven, tasks, jobs=processes or default_jobs()):
        done[manoeuvre.key] = manoeuvre
        progress(len(done), len(MANOEUVRES), manoeuvre.title)
    return Assessment(
        vehicle=vehicle,
        trailer_steering=trailer_steering,
        manoeuvres=tuple(done[key] for key in MANOEUVRES),
        linear=linear_figures(vehicle),
    )


def _driven(task: tuple[str, Vehicle, str]) -> Manoeuvre:
    key, vehicle, trailer_steering = task
    return tilt(vehicle) if key == "tilt" else _DRIVEN[key](vehicle, trailer_steering)


def _finite(figures: Figures) -> dict[str, float | None]:
    return {name: round(value, 6) if math.isfinite(value) else None for name, value in figures.items()}


def _judgement(judgement: Judgement) -> dict[str, Any]:
    criterion = judgement.criterion
    return {
        "quantity": criterion.quantity,
        "standard": criterion.standard,
        "measured": round(judgement.measured, 6) if math.isfinite(judgement.measured) else None,
        "must_be": "at most" if criterion.at_most else "at least",
        "bounds": {level or "required": round(bound, 6) for level, bound in judgement.bounds if math.isfinite(bound)},
        "reached": judgement.reached,
        "source": criterion.source,
    }
