"""What measured figures are compared with: limits of the standards with their levels, and linear theory.

Most of these numbers are from memory, not from the text of the standards; the tables that show them say so. A clause
that is cited from memory is marked in the same way.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import Final

import numpy as np

from offtrack.studies.standards import lane_change, random_steer, yaw_stability
from offtrack.studies.standards.proving_ground import Figures
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.handling import static_rollover_threshold, understeer_gradient, yaw_damping
from vehicle.combination.linear import ComplexArray, OutputKind, lateral_model
from vehicle.frames import FloatArray

_PBS: Final = "PBS (Australia)"
_SWEDISH: Final = "HCT (Sweden), typical"
_OPENPBS: Final = "OpenPBS documentation, read; it names no clause, so take the number as from memory"


def _pbs(clause: str, note: str = "") -> str:
    return f"from memory: PBS Scheme, The Standards and Vehicle Assessment Rules, {clause}{note}"


@dataclass(frozen=True, slots=True)
class Criterion:
    """Limits of a standard on a quantity, strictest first."""

    quantity: str
    standard: str
    bounds: tuple[tuple[str, float], ...]  # level and its limit; a single limit has the level ""
    _: KW_ONLY
    at_most: bool = True  # True: the limit is an upper one; False: a lower one
    times: str | None = None  # the limits are multiples of this other quantity
    source: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A criterion compared with the measured quantity."""

    criterion: Criterion
    measured: float  # NaN: not measured
    bounds: tuple[tuple[str, float], ...]  # limits for this combination

    @property
    def reached(self) -> str:
        """Strictest level reached, or "none"; "met" or "missed" for a single limit; "not measured"."""
        if not math.isfinite(self.measured) or any(math.isnan(bound) for _, bound in self.bounds):
            return "not measured"
        sign = 1.0 if self.criterion.at_most else -1.0
        for level, bound in self.bounds:
            if sign * self.measured <= sign * bound:
                return level or "met"
        return "none" if self.bounds[0][0] else "missed"


def compared_with_limits(figures: Figures) -> tuple[Judgement, ...]:
    """Judgements for all criteria whose quantity is among the figures, even if it is NaN."""
    return tuple(
        Judgement(criterion=c, measured=figures[c.quantity], bounds=_bounds(c, figures))
        for c in CRITERIA
        if c.quantity in figures
    )


def _bounds(criterion: Criterion, figures: Figures) -> tuple[tuple[str, float], ...]:
    factor = 1.0 if criterion.times is None else figures.get(criterion.times, math.nan)
    return tuple((level, factor * bound) for level, bound in criterion.bounds)


def _levels(*bounds: float) -> tuple[tuple[str, float], ...]:
    return tuple((f"level {k}", bound) for k, bound in enumerate(bounds, start=1))


def _single(bound: float) -> tuple[tuple[str, float], ...]:
    return (("", bound),)


CRITERIA: Final = (
    Criterion(
        "braking_mean_deceleration_m_s2",
        "UN R13",
        _single(5.0),
        at_most=False,
        source="from memory: UN R13, annex 4, 1.4, type-0 test of N2 and N3",
    ),
    Criterion(
        "braking_distance_m",
        "UN R13",
        _single(0.15 * 60.0 + 60.0**2 / 130.0),
        source="from memory: UN R13, annex 4, 1.4, type-0 test of N2 and N3, 0.15 v + v^2 / 130 in km/h",
    ),
    Criterion(
        "braking_lane_m",
        "FMVSS 121",
        _single(12.0 * 0.3048),
        source="from memory: FMVSS 121, S5.3.6, a lane of 12 ft; of truck tractors there",
    ),
    Criterion("startability", _PBS, _levels(0.15, 0.12, 0.10, 0.05), at_most=False, source=_pbs("C1")),
    Criterion("gradeability", _PBS, _levels(0.20, 0.15, 0.12, 0.08), at_most=False, source=_pbs("C2", ", a")),
    Criterion(
        "gradeability_speed_m_s",
        _PBS,
        _levels(80.0 / 3.6, 70.0 / 3.6, 70.0 / 3.6, 60.0 / 3.6),
        at_most=False,
        source=_pbs("C2", ", b"),
    ),
    Criterion("acceleration_100_m_s", _PBS, _levels(20.0, 23.0, 26.0, 29.0), source=_pbs("C3")),
    Criterion("swept_path_m", _PBS, _levels(7.4, 8.7, 10.6, 13.7), source=_pbs("C7")),
    Criterion("swept_path_m", _SWEDISH, _single(8.5), source=_OPENPBS),
    Criterion("frontal_swing_m", _PBS, _single(0.7), source=_pbs("C8")),
    Criterion("frontal_swing_mod_m", _PBS, _single(0.4), source=_pbs("C8")),
    Criterion("frontal_swing_dom_m", _PBS, _single(0.2), source=_pbs("C8")),
    Criterion("tail_swing_entry_m", _PBS, _levels(0.30, 0.35, 0.35, 0.50), source=_pbs("C9")),
    Criterion(
        "tail_swing_exit_m",
        _PBS,
        _levels(0.30, 0.35, 0.35, 0.50),
        source=_pbs("C9", "; for the entry; applied to the exit too, as steered trailers swing there"),
    ),
    Criterion("steer_friction_demand", _PBS, _single(0.80), source=_pbs("C10")),
    Criterion(
        "roundabout_inner_radius_m",
        "96/53/EC",
        _single(5.30),
        at_most=False,
        source="96/53/EC, annex I, 1.5; wording read in an extract, number of the clause from memory",
    ),
    Criterion(
        "roundabout_inner_radius_m",
        "97/27/EC",
        _single(5.30),
        at_most=False,
        source="97/27/EC, annex I, 7.6.1, read in extracts",
    ),
    Criterion(
        "roundabout_tail_swing_m",
        "97/27/EC",
        _single(0.80),
        source="from memory: 97/27/EC, annex I, 7.6.2, for rigid vehicles on entry",
    ),
    Criterion(
        "rearward_amplification",
        _PBS,
        _single(5.7),
        times="rollover_threshold_g",
        source=_pbs("C12", ": 5.7 times the static rollover threshold in g"),
    ),
    Criterion(
        "front_path_error_m",
        "ISO 14791",
        _single(0.15),
        source="from memory: ISO 14791, single lane change; the path of the front axle within 150 mm",
    ),
    Criterion("transient_off_tracking_m", _PBS, _levels(0.6, 0.8, 1.0, 1.2), source=_pbs("C13")),
    Criterion(
        "tracking_width_m", _PBS, _levels(2.9, 3.0, 3.1, 3.3), source=_pbs("C5", "; the 99th percentile of the width")
    ),
    Criterion("yaw_damping", _PBS, _single(0.15), at_most=False, source=_pbs("C14")),
    Criterion(
        "rollover_threshold_g", _PBS, (("dangerous goods", 0.40), ("general", 0.35)), at_most=False, source=_pbs("C11")
    ),
    Criterion("rollover_acceleration_m_s2", _SWEDISH, _single(3.5), at_most=False, source=_OPENPBS),
)


_LENGTH = 41.0  # of the periodic lane change [s]: all motion decays in the last 37 s
_STEP = 0.01  # [s]
_CIRCLE_SPEED = 8.0  # on the steady circle of 100 m, at 0.065 g [m/s]


def linear_figures(vehicle: Vehicle, *, speed: float | None = None, tyre_dynamics: bool = True) -> Figures:
    """Figures by linear theory, with the names of the measured ones; without those that do not apply.

    Without ``speed`` [m/s] the manoeuvres have their own. Without ``tyre_dynamics`` tyres, roll and hitch forces follow
    without lag.
    """
    return {
        "yaw_damping": yaw_damping(vehicle, speed or yaw_stability.SPEED, tyre_dynamics=tyre_dynamics),
        "rollover_threshold_g": static_rollover_threshold(vehicle) / GRAVITY,
        "understeer_gradient_deg_per_g": math.degrees(understeer_gradient(vehicle, _CIRCLE_SPEED)) * GRAVITY,
        "random_amplification": random_steer.theoretical_peak(vehicle, speed or random_steer.SPEED),
        **(
            _lane_change(vehicle, speed or lane_change.SPEED, tyre_dynamics=tyre_dynamics)
            if len(vehicle.units) > 1
            else {}
        ),
    }


def _lane_change(vehicle: Vehicle, speed: float, *, tyre_dynamics: bool) -> Figures:
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
    prescribed = np.fft.rfft(lane_change.prescribed_acceleration(time))[1:]

    def motion(ratio: ComplexArray) -> FloatArray:
        values: FloatArray = np.fft.irfft(np.concatenate([[0.0], prescribed * ratio]), count)
        return values

    yaw = [motion(response[f"yaw_rate_{unit}"] / front) for unit in (0, last)]
    offset = motion((response[f"axle_position_{axle}"] - response["axle_position_0"]) / front)
    return {
        "rearward_amplification": _peak(motion(response[f"lateral_acceleration_{last}"] / front)) / lane_change.PEAK,
        "rearward_amplification_yaw": _peak(yaw[1]) / _peak(yaw[0]),
        "transient_off_tracking_m": float(np.max(offset) - offset[0]),  # before the change there is no offset
    }


def _peak(values: FloatArray) -> float:
    return float(np.max(np.abs(values)))
