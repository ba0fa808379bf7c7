"""Names of the standard manoeuvres, what each is, and which conditions it takes; light, for the command's help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from vehicle.foundation.parameter_file import nearest

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
