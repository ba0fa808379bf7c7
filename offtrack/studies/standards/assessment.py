"""Assessment of a combination: standard manoeuvres in load cases and to both hands, compared with the standards."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from offtrack.studies.standards.comparison import Judgement, compared_with_limits, linear_figures
from offtrack.studies.standards.full_braking import braking, braking_in_turn, braking_slippery, braking_split
from offtrack.studies.standards.lane_change import lane_change
from offtrack.studies.standards.longitudinal_capability import longitudinal
from offtrack.studies.standards.low_speed import aashto_turn, ctsw_turn, roundabout, turn
from offtrack.studies.standards.proving_ground import STANDARD, Conditions, Figures, Manoeuvre
from offtrack.studies.standards.random_steer import random_steer
from offtrack.studies.standards.static_rollover import closing_curve, tilt
from offtrack.studies.standards.steady_circle import steady_circle
from offtrack.studies.standards.straight import crosswind, straight
from offtrack.studies.standards.yaw_stability import pulse, sine_with_dwell
from scenarios.processes import as_finished, default_jobs
from scenarios.progress import Progress, no_progress
from vehicle.combination.data_sheet import data_sheet
from vehicle.combination.description import Vehicle
from vehicle.combination.variants import FULL, load_cases, with_load
from vehicle.foundation.user_file import nearest

if TYPE_CHECKING:
    from offtrack.studies.standards.proving_ground import Conditions


_KMH: Final = 1.0 / 3.6  # [m/s]
_SLOW: Final = (1.0 * _KMH, 20.0 * _KMH)  # [m/s]
_FAST: Final = (30.0 * _KMH, 120.0 * _KMH)  # [m/s]
_TURNS: Final = (8.0, 100.0)  # [m]
_FRICTIONS: Final = (0.05, 1.5)  # [-]


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of manoeuvre and the limits of its conditions; None: it has no such condition."""

    key: str
    line: str  # what it is
    seconds: float  # of driving, about; longer ones are started first
    speeds: tuple[float, float] | None = _FAST  # [m/s]
    radii: tuple[float, float] | None = None  # [m]
    frictions: tuple[float, float] | None = _FRICTIONS  # [-]
    handed: bool = True  # it turns to one side first

    def differs(self, conditions: Conditions) -> bool:
        """True if the manoeuvre is driven under other conditions than the standard's."""
        return any(
            value is not None and limits is not None
            for value, limits in (
                (conditions.speed, self.speeds),
                (conditions.radius, self.radii),
                (conditions.friction, self.frictions),
            )
        )


KINDS: Final = {
    kind.key: kind
    for kind in (
        Kind(
            key="turn",
            line="low-speed turn of performance-based standards: 90°, the outer steered tyre's wall on 12.5 m, 5 km/h",
            seconds=60.0,
            speeds=_SLOW,
            radii=_TURNS,
        ),
        Kind(
            key="roundabout",
            line="EU circle of 96/53/EC: 360° between circles of 12.50 m and 5.30 m, 5 km/h",
            seconds=110.0,
            speeds=_SLOW,
            radii=_TURNS,
        ),
        Kind(
            key="aashto_turn",
            line="AASHTO design-vehicle template: 180°, the front axle's centre on 41 ft (12.50 m), 5 km/h",
            seconds=80.0,
            speeds=_SLOW,
            radii=_TURNS,
        ),
        Kind(
            key="ctsw_turn",
            line="Comprehensive Truck Size and Weight turn: 90°, the front axle's centre on 41 ft (12.50 m), 5 km/h",
            seconds=60.0,
            speeds=_SLOW,
            radii=_TURNS,
        ),
        Kind(
            key="lane_change",
            line="single lane change of ISO 14791: 0.4 Hz and 0.15 g at the front axle, 88 km/h",
            seconds=80.0,
        ),
        Kind(
            key="straight",
            line="tracking on 1 km of straight rough road with 3 % cross-fall, 90 km/h",
            seconds=50.0,
            handed=False,
        ),
        Kind(
            key="pulse",
            line="steer pulse for the yaw damping, 80 km/h",
            seconds=12.0,
        ),
        Kind(
            key="steady_circle",
            line="constant-radius circle of 100 m up to 0.25 g, after ISO 14792: understeer gradient, off-tracking",
            seconds=70.0,
            speeds=None,
            radii=(50.0, 500.0),
        ),
        Kind(
            key="sine_with_dwell",
            line="sine with dwell of 0.5 Hz and 1 s at 72 km/h: residual yaw, load transfer",
            seconds=10.0,
        ),
        Kind(
            key="random_steer",
            line="pseudo-random steer at 88 km/h: frequency response of rearward amplification",
            seconds=80.0,
            handed=False,
        ),
        Kind(
            key="tilt",
            line="tilt table for the static rollover threshold",
            seconds=30.0,
            speeds=None,
            frictions=None,
            handed=False,
        ),
        Kind(
            key="closing_curve",
            line="closing curve as in ISO 11026: slow ramp of steer at 60 km/h until rolling over",
            seconds=60.0,
        ),
        Kind(
            key="braking",
            line="full braking to a stop on dry road, 60 km/h",
            seconds=10.0,
            handed=False,
        ),
        Kind(
            key="braking_slippery",
            line="full braking to a stop at friction 0.3, 60 km/h",
            seconds=12.0,
            handed=False,
        ),
        Kind(
            key="braking_split",
            line="full braking to a stop at friction 0.8 on one side and 0.2 on the other, 60 km/h",
            seconds=12.0,
            frictions=None,
        ),
        Kind(
            key="braking_in_turn",
            line="full braking on a curve of 500 ft (152 m) at friction 0.5, 30 mph (48 km/h)",
            seconds=12.0,
            radii=(50.0, 1000.0),
        ),
        Kind(
            key="crosswind",
            line="gust of 20 m/s across the road, steering held, as in ISO 12021, 80 km/h",
            seconds=8.0,
        ),
        Kind(
            key="longitudinal",
            line="startability, gradeability, acceleration and holding downhill, straight ahead",
            seconds=100.0,
            speeds=None,
            handed=False,
        ),
    )
}
STANDARD_SET: Final = ("turn", "roundabout", "lane_change", "straight", "pulse", "tilt")  # driven by default
OTHER_NAMES: Final = {
    "pbs_turn": "turn",
    "eu_circle": "roundabout",
    "iso14791": "lane_change",
    "tilt_table": "tilt",
    "iso11026": "closing_curve",
    "iso12021": "crosswind",
}


def chosen(names: Sequence[str]) -> tuple[Kind, ...]:
    """Kinds of these names in the order of the report; ``all`` is every kind, ``standard`` those driven by default.

    Raises:
        ValueError: one line, for an unknown name.
    """
    keys: set[str] = set()
    for name in names:
        key = OTHER_NAMES.get(name, name)
        if key not in (*KINDS, "all", "standard"):
            raise ValueError(f"manoeuvre '{name}' is unknown{nearest(name, (*KINDS, *OTHER_NAMES, 'all', 'standard'))}")
        keys |= {"all": set(KINDS), "standard": set(STANDARD_SET)}.get(key, {key})
    return tuple(kind for key, kind in KINDS.items() if key in keys)


def check_conditions(kinds: Sequence[Kind], conditions: Conditions) -> None:
    """Refuse conditions that a manoeuvre can not be driven under, or that none of them has.

    Raises:
        ValueError: one line.
    """
    for name, unit, factor, value, limits in (
        ("speed", "km/h", 3.6, conditions.speed, [kind.speeds for kind in kinds]),
        ("radius", "m", 1.0, conditions.radius, [kind.radii for kind in kinds]),
        ("friction", "", 1.0, conditions.friction, [kind.frictions for kind in kinds]),
    ):
        if value is None:
            continue
        if not any(limits):
            raise ValueError(f"--{name}: none of the manoeuvres {', '.join(kind.key for kind in kinds)} has a {name}")
        for kind, limit in zip(kinds, limits, strict=True):
            if limit is not None and not limit[0] <= value * (1.0 + 1e-12) <= limit[1] * (1.0 + 2e-12):
                low, high = (factor * bound for bound in limit)
                said = f"--{name} {factor * value:g}: {kind.key} is driven at {low:g} to {high:g} {unit}".rstrip()
                raise ValueError(f"{said}; choose others with --manoeuvres")


Drive: TypeAlias = Callable[[Vehicle, str, Conditions], Manoeuvre]  # with the law that steers the last unit

DRIVES: Final[dict[str, Drive]] = {
    "turn": turn,
    "roundabout": roundabout,
    "aashto_turn": aashto_turn,
    "ctsw_turn": ctsw_turn,
    "lane_change": lane_change,
    "straight": straight,
    "pulse": pulse,
    "steady_circle": steady_circle,
    "sine_with_dwell": sine_with_dwell,
    "random_steer": random_steer,
    "closing_curve": closing_curve,
    "crosswind": crosswind,
    "tilt": tilt,
    "braking": braking,
    "braking_slippery": braking_slippery,
    "braking_split": braking_split,
    "braking_in_turn": braking_in_turn,
    "longitudinal": longitudinal,
}


MANOEUVRES: Final = STANDARD_SET  # in the order of the report
AS_IN_FILE: Final = FULL  # load case of a vehicle as its file describes it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessment:
    """A combination in one load case, in standard manoeuvres to one hand."""

    vehicle: Vehicle
    trailer_steering: str
    manoeuvres: tuple[Manoeuvre, ...]
    linear: Figures  # by linear theory, where it applies
    load: str = AS_IN_FILE
    conditions: Conditions = STANDARD

    @property
    def figures(self) -> Figures:
        """All measured quantities by name."""
        return {name: value for manoeuvre in self.manoeuvres for name, value in manoeuvre.figures.items()}

    @property
    def judgements(self) -> tuple[Judgement, ...]:
        """All criteria of the standards that apply, compared with the measured quantities.

        Manoeuvres under other conditions than the standard's are not compared.
        """
        applicable = {
            name: value
            for manoeuvre in self.manoeuvres
            if not KINDS[manoeuvre.key].differs(self.conditions)
            for name, value in manoeuvre.figures.items()
            if math.isfinite(value) or manoeuvre.outcome != "completed"
        }
        return compared_with_limits(applicable)

    def summary(self) -> dict[str, Any]:
        """The assessment for JSON; null where a quantity could not be measured."""
        return {
            "manoeuvres": {
                manoeuvre.key: {"outcome": manoeuvre.outcome, **_finite(manoeuvre.figures)}
                for manoeuvre in self.manoeuvres
            },
            "linear_theory": _finite(self.linear),
            "levels": [_judgement(judgement) for judgement in self.judgements],
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AssessmentMatrix:
    """A combination in all chosen load cases and hands."""

    vehicle: Vehicle  # as its file describes it
    cases: tuple[Assessment, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Contradictions between the vehicle's numbers, in any load case."""
        lines = ((case.load, line) for case in self.cases for line in data_sheet(case.vehicle).warnings)
        return tuple(dict.fromkeys(line if load == AS_IN_FILE else f"{load}: {line}" for load, line in lines))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cases: load, hand, or both, as they differ."""
        loads, hands = (
            list(parts) for parts in zip(*((case.load, case.conditions.hand) for case in self.cases), strict=True)
        )
        if len(set(hands)) == 1:
            return tuple(loads)
        return tuple(hands if len(set(loads)) == 1 else [", ".join(parts) for parts in zip(loads, hands, strict=True)])

    def summary(self) -> dict[str, Any]:
        """The assessment for JSON: the first case at the top, and all of them in ``cases``."""
        first = self.cases[0]
        return {
            "vehicle": self.vehicle.name,
            "trailer_steering": first.trailer_steering,
            **first.summary(),
            "warnings": list(self.warnings),
            "conditions": {
                "speed_kmh": None if first.conditions.speed is None else round(3.6 * first.conditions.speed, 6),
                "radius_m": first.conditions.radius,
                "friction": first.conditions.friction,
            },
            "cases": [{"load": case.load, "hand": case.conditions.hand, **case.summary()} for case in self.cases],
        }


def assess(
    vehicle: Vehicle,
    *,
    trailer_steering: str = "none",
    manoeuvres: Sequence[str] = MANOEUVRES,
    cases: Sequence[tuple[str, Vehicle]] = (),
    conditions: Sequence[Conditions] = (STANDARD,),
    progress: Progress = no_progress,
    processes: int | None = None,
) -> AssessmentMatrix:
    """Drive a combination through standard manoeuvres.

    Args:
        vehicle: the combination, laden as in its file.
        trailer_steering: law for the last unit's steered axles, fed with the exact off-tracking; "none" keeps them
            straight.
        manoeuvres: their names, see ``catalogue.chosen``.
        cases: names of load cases, and the combination in each; by default the vehicle as it is.
        conditions: each manoeuvre is driven under each of them. Those without a hand are driven under the first only.
        progress: callback with the number of finished manoeuvres and the title of the last one.
        processes: number of processes; by default one per core.

    Raises:
        ValueError: one line, if the vehicle has no axles for the law to steer, or can not be driven, or for an unknown
            manoeuvre or conditions that it can not be driven under.
    """
    kinds, loads = chosen(manoeuvres), tuple(cases) or ((AS_IN_FILE, vehicle),)
    check_conditions(kinds, conditions[0])
    tasks = [
        _Task(case, kind.key, loaded, trailer_steering, condition)
        for case, ((_, loaded), condition) in enumerate((load, condition) for load in loads for condition in conditions)
        for kind in kinds
        if kind.handed or condition is conditions[0]
    ]
    done: dict[tuple[int, str], Manoeuvre] = {}
    progress(0, len(tasks))
    longest_first = sorted(tasks, key=lambda task: -KINDS[task.key].seconds)
    for task, manoeuvre in as_finished(_driven, longest_first, jobs=processes or default_jobs()):
        done[task.case, task.key] = manoeuvre
        progress(len(done), len(tasks), manoeuvre.title)
    return AssessmentMatrix(
        vehicle=vehicle,
        cases=tuple(
            Assessment(
                vehicle=loaded,
                load=load,
                conditions=condition,
                trailer_steering=trailer_steering,
                manoeuvres=tuple(done[case, kind.key] for kind in kinds if (case, kind.key) in done),
                linear=linear_figures(loaded, speed=condition.speed),
            )
            for case, ((load, loaded), condition) in enumerate(
                (load, condition) for load in loads for condition in conditions
            )
        ),
    )


def loaded(vehicle: Vehicle, names: Sequence[str]) -> tuple[tuple[str, Vehicle], ...]:
    """Load cases of these names with the combination in each; ``all`` is every case.

    Raises:
        ValueError: one line, for an unknown case, or one that the vehicle does not have.
    """
    cases: list[str] = []
    for name in names:
        cases += load_cases(vehicle)[::-1] if name == "all" else [name]
    return tuple((case, with_load(vehicle, case)) for case in dict.fromkeys(cases))


@dataclass(frozen=True, slots=True)
class _Task:
    """A manoeuvre to drive."""

    case: int
    key: str
    vehicle: Vehicle
    trailer_steering: str
    conditions: Conditions


def _driven(task: _Task) -> Manoeuvre:
    return DRIVES[task.key](task.vehicle, task.trailer_steering, task.conditions)


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
