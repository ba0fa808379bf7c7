"""Assessment of a combination: standard manoeuvres in load cases and to both hands, compared with the standards.

Measured figures are compared with the limits of the standards, and with linear theory. Most of the limits are from
memory, not from the text of the standards; the tables that show them say so.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from controllers.trailer_steering.lqr import law_warnings
from offtrack.studies.standards.braking_and_drive import (
    braking,
    braking_in_turn,
    braking_slippery,
    braking_split,
    longitudinal,
)
from offtrack.studies.standards.low_speed import aashto_turn, ctsw_turn, roundabout, turn
from offtrack.studies.standards.open_loop import (
    CHANGE_PEAK,
    lane_change,
    linear_pulse_damping,
    prescribed_acceleration,
    pulse,
    random_steer,
    sine_with_dwell,
    theoretical_peak,
)
from offtrack.studies.standards.proving_ground import (
    KINDS,
    STANDARD,
    Conditions,
    Figures,
    Kind,
    Manoeuvre,
    read_tables,
    steered_trailer,
)
from offtrack.studies.standards.static_rollover import closing_curve, tilt
from offtrack.studies.standards.steady_driving import crosswind, steady_circle, straight
from scenarios.processes import as_finished, default_jobs
from scenarios.progress import Progress, no_progress
from vehicle.combination.data_sheet import data_sheet
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.handling import static_rollover_threshold, understeer_gradient
from vehicle.combination.linear import ComplexArray, OutputKind, lateral_model
from vehicle.combination.variants import FULL, load_cases, with_load
from vehicle.foundation.user_file import nearest
from vehicle.frames import FloatArray

UNDECIDED: Final = "not decided"


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """Limits of a standard on a quantity, strictest first."""

    quantity: str
    standard: str
    source: str
    at_least: bool = False  # True: the limits are lower ones; False: upper ones
    times: str | None = None  # the limits are multiples of this other quantity
    spread: str | None = None  # figures NAME_low_g, NAME_g and NAME_high_g say how well the quantity is known
    bounds: tuple[tuple[str, float], ...]  # level and its limit; a single limit has the level ""

    @classmethod
    def of(cls, table: dict[str, Any]) -> "Criterion":
        """The limits of a table of ``limits.toml``."""
        bounds = [*table.pop("named", {}).items()] + ([("", table.pop("limit"))] if "limit" in table else [])
        bounds += [(f"level {k}", bound) for k, bound in enumerate(table.pop("levels", ()), start=1)]
        return cls(bounds=tuple(bounds), **table)

    def judge(self, figures: Figures) -> "Judgement":
        """Comparison with the measured quantity."""
        factor = 1.0 if self.times is None else figures.get(self.times, math.nan)
        bounds = tuple((level, factor * bound) for level, bound in self.bounds)
        measured, known = figures[self.quantity], figures.get(f"{self.spread}_g", math.nan)
        ends = (measured * figures.get(f"{self.spread}_{end}_g", math.nan) / known for end in ("low", "high"))
        return Judgement(criterion=self, measured=measured, bounds=bounds, ends=tuple(filter(math.isfinite, ends)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A criterion compared with the measured quantity."""

    criterion: Criterion
    measured: float  # NaN: not measured
    bounds: tuple[tuple[str, float], ...]  # limits for this combination
    ends: tuple[float, ...] = ()  # least and largest value for what is not known of the vehicle, if that is stated

    @property
    def reached(self) -> str:
        """Strictest level reached, or "none"; "met" or "missed" for a single limit; "not measured".

        "not decided" if a level lies between the ``ends``.
        """
        if not math.isfinite(self.measured) or any(math.isnan(bound) for _, bound in self.bounds):
            return "not measured"
        levels = {self._level(value) for value in (self.measured, *self.ends)}
        return levels.pop() if len(levels) == 1 else UNDECIDED

    def _level(self, value: float) -> str:
        sign = -1.0 if self.criterion.at_least else 1.0
        for level, bound in self.bounds:
            if sign * value <= sign * bound:
                return level or "met"
        return "none" if self.bounds[0][0] else "missed"


CRITERIA: Final = tuple(map(Criterion.of, read_tables("limits.toml")["limits"]))


def compared_with_limits(figures: Figures) -> tuple[Judgement, ...]:
    """Judgements for all criteria whose quantity is among the figures, even if it is NaN."""
    return tuple(criterion.judge(figures) for criterion in CRITERIA if criterion.quantity in figures)


_LENGTH = 41.0  # of the periodic lane change [s]: all motion decays in the last 37 s
_STEP = 0.01  # [s]
_CIRCLE_SPEED = 8.0  # on the steady circle of 100 m, at 0.065 g [m/s]


def linear_figures(vehicle: Vehicle, *, speed: float | None = None, tyre_dynamics: bool = True) -> Figures:
    """Figures by linear theory, with the names of the measured ones; without those that do not apply.

    Without ``speed`` [m/s] the manoeuvres have their own. Without ``tyre_dynamics`` tyres, roll and hitch forces follow
    without lag.
    """
    return {
        "yaw_damping": linear_pulse_damping(vehicle, speed or KINDS["pulse"].speed, tyre_dynamics=tyre_dynamics),
        "rollover_threshold_g": static_rollover_threshold(vehicle) / GRAVITY,
        "understeer_gradient_deg_per_g": math.degrees(understeer_gradient(vehicle, _CIRCLE_SPEED)) * GRAVITY,
        "random_amplification": theoretical_peak(vehicle, speed or KINDS["random_steer"].speed),
        **(
            _linear_lane_change(vehicle, speed or KINDS["lane_change"].speed, tyre_dynamics=tyre_dynamics)
            if len(vehicle.units) > 1
            else {}
        ),
    }


def _linear_lane_change(vehicle: Vehicle, speed: float, *, tyre_dynamics: bool) -> Figures:
    """Lane change with the front axle exactly on its path.

    Ratios of frequency responses give all motions from the front axle's; the steer cancels. The last axle is farthest
    out when the front axle is already on the straight line, so its later arrival does not matter.
    """
    count = round(_LENGTH / _STEP)
    time: FloatArray = _STEP * np.arange(count, dtype=np.float64)
    f = np.fft.rfftfreq(count, _STEP)[1:]  # 0 Hz is omitted: the mean of one sine period is 0
    s = 2j * math.pi * f
    kinds: tuple[OutputKind, ...] = ("lateral_acceleration", "yaw_rate", "axle_position")
    model = lateral_model(vehicle, speed, outputs=kinds, path=True, tyre_dynamics=tyre_dynamics)
    response = {name: model.response(name, f) for name in model.outputs}
    last, axle = len(vehicle.units) - 1, sum(len(unit.axles) for unit in vehicle.units) - 1
    front = response["axle_position_0"] * s**2
    prescribed = np.fft.rfft(prescribed_acceleration(time))[1:]

    def motion(ratio: ComplexArray) -> FloatArray:
        values: FloatArray = np.fft.irfft(np.concatenate([[0.0], prescribed * ratio]), count)
        return values

    yaw = [motion(response[f"yaw_rate_{unit}"] / front) for unit in (0, last)]
    offset = motion((response[f"axle_position_{axle}"] - response["axle_position_0"]) / front)
    return {
        "rearward_amplification": _peak(motion(response[f"lateral_acceleration_{last}"] / front)) / CHANGE_PEAK,
        "rearward_amplification_yaw": _peak(yaw[1]) / _peak(yaw[0]),
        "transient_off_tracking_m": float(np.max(offset) - offset[0]),  # before the change there is no offset
    }


def _peak(values: FloatArray) -> float:
    return float(np.max(np.abs(values)))


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
    drive.__name__: drive
    for drive in (
        *(turn, roundabout, aashto_turn, ctsw_turn, lane_change, straight, pulse, steady_circle, sine_with_dwell),
        *(random_steer, tilt, closing_curve, braking, braking_slippery, braking_split, braking_in_turn, crosswind),
        longitudinal,
    )
}


_AGREES: Final = 0.03  # largest difference of measurement and theory that needs no reason
_LINEAR: Final = "theory takes linear tyres at their static loads"
_OF_UNSTEERED: Final = "theory is of the trailer with straight axles"
_REASONS: Final = {
    "rollover_threshold_g": "theory is a steady turn on the level; across a slope the springs carry less",
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

    @property
    def warnings(self) -> list[str]:
        """Contradictions between the vehicle's numbers, and a law that gave way at the speeds of the manoeuvres."""
        steered = steered_trailer(self.vehicle, self.trailer_steering)
        fastest = max((KINDS[one.key].under(self.conditions).speed for one in self.manoeuvres), default=0.0)
        of_law = [] if steered is None else law_warnings(steered.law.law, fastest)
        return [*data_sheet(self.vehicle).warnings, *of_law]

    def disagreements(self, named: Callable[[str], str] = str) -> tuple[str, ...]:
        """Lines on the quantities that differ from linear theory by more than 3 %, with the reason."""
        lines = []
        for name, theory in self.linear.items():
            measured = self.figures.get(name, math.nan)
            if abs(measured - theory) > _AGREES * abs(theory):
                why = _OF_UNSTEERED if self.trailer_steering != "none" else _REASONS.get(name, _LINEAR)
                lines.append(f"{named(name)}: {measured:.4g} measured, {theory:.4g} by linear theory: {why}")
        return tuple(lines)

    def summary(self) -> dict[str, Any]:
        """The assessment for JSON; null where a quantity could not be measured."""
        return {
            "manoeuvres": {
                manoeuvre.key: {"outcome": manoeuvre.outcome, **_finite(manoeuvre.figures)}
                for manoeuvre in self.manoeuvres
            },
            "linear_theory": _finite(self.linear),
            "disagreements": list(self.disagreements()),
            "levels": [_judgement(judgement) for judgement in self.judgements],
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class AssessmentMatrix:
    """A combination in all chosen load cases and hands."""

    vehicle: Vehicle  # as its file describes it
    cases: tuple[Assessment, ...]

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of all load cases; laws are constructed for them."""
        lines = ((case.load, line) for case in self.cases for line in case.warnings)
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
        manoeuvres: their names, see ``chosen``.
        cases: names of load cases, and the combination in each; by default the vehicle as it is.
        conditions: each manoeuvre is driven under each of them. Those without a hand are driven under the first only.
        progress: callback with the number of finished manoeuvres and the title of the last one.
        processes: number of processes; by default one per core.

    Raises:
        ValueError: one line, if the vehicle has no axles for the law to steer, or can not be driven, or for an unknown
            manoeuvre or conditions that it can not be driven under.
    """
    kinds = chosen(manoeuvres)
    check_conditions(kinds, conditions[0])
    each = [(load, condition) for load in tuple(cases) or ((AS_IN_FILE, vehicle),) for condition in conditions]
    tasks = [
        _Task(case, kind.key, loaded, trailer_steering, condition)
        for case, ((_, loaded), condition) in enumerate(each)
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
            for case, ((load, loaded), condition) in enumerate(each)
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


class _Task(NamedTuple):
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
        "must_be": "at least" if criterion.at_least else "at most",
        "bounds": {level or "required": round(bound, 6) for level, bound in judgement.bounds if math.isfinite(bound)},
        "reached": judgement.reached,
        **({"range": [round(end, 6) for end in judgement.ends]} if judgement.ends else {}),
        "source": criterion.source,
    }
