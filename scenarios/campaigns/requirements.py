"""Requirements of a campaign: limits of numbers of the summary, outcomes, times to detect and to recover."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from scenarios.report.numbers import groups
from vehicle.parameter_file import nearest
from vehicle.user_file import shown

OUTCOMES: Final = ("completed", "jackknifed", "rolled over", "left the road", "timed out", "diverged")
DETECT, HARMLESS, ALLOWED = "time_to_detect_s", "harmless_below_m", "outcomes"
RECOVER, BELOW = "time_to_recover_s", "recovered_below_m"
_OWN: Final = (ALLOWED, DETECT, HARMLESS, RECOVER, BELOW)
_LARGEST: Final = 1e12
_UNITS: Final = {"_deg_s": "°/s", "_deg": "°", "_percent": "%", "_m": "m", "_s": "s"}
GROUPS: Final = ("off_tracking", "swept_path", "road", "steer", "tyres", "slip", "odometry", "position", "wheels")


class Limit(NamedTuple):
    """Limits of a number ``group.name`` of the summary, in the summary's unit."""

    path: str
    low: float = -math.inf
    high: float = math.inf

    @property
    def text(self) -> str:
        """The limits, as tables show them."""
        of, unit = label_and_unit(self.path)
        parts = [f"at least {self.low:g}"] if self.low > -math.inf else []
        parts += [f"at most {self.high:g}"] if self.high < math.inf else []
        return f"{of}: {', '.join(parts)} {unit}".strip()

    def severity(self, value: float) -> float:
        """Value over its limit: above 1 it is beyond it."""
        above = value / self.high if self.high > 0.0 else 1.0 + value - self.high
        below = 1.0 + (self.low - value) / max(abs(self.low), 1.0)
        return max(above if self.high < math.inf else -math.inf, below if self.low > -math.inf else -math.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class Requirements:
    """Requirements that each run must keep."""

    limits: tuple[Limit, ...] = ()
    outcomes: tuple[str, ...] = ("completed",)  # that are no failures
    detect: float | None = None  # longest time from the onset of a fault until it is noticed [s]; None: any
    harmless_below: float = 0.0  # off-tracking up to which a fault need not be noticed [m]
    recover: float | None = None  # longest time from the end of a fault until all is well again [s]; None: any
    recovered_below: float = 0.2  # off-tracking that counts as recovered [m]

    def table(self) -> dict[str, Any]:
        """The table ``requirements`` of a campaign file."""
        table: dict[str, Any] = {ALLOWED: list(self.outcomes), BELOW: self.recovered_below}
        for limit in self.limits:
            known = {"min": limit.low, "max": limit.high}
            table[limit.path] = {key: value for key, value in known.items() if math.isfinite(value)}
        times = {DETECT: self.detect, HARMLESS: self.harmless_below or None, RECOVER: self.recover}
        return table | {key: value for key, value in times.items() if value is not None}


def label_and_unit(path: str) -> tuple[str, str]:
    """Label of a number and the unit that its name ends with."""
    group, _, name = path.partition(".")
    unit = next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")
    return groups()[group].numbers[name].label, unit


def read_requirements(place: str, table: Iterable[tuple[str, Any]]) -> Requirements:
    """Requirements of a campaign file, from the dotted keys of its table ``requirements``.

    A number of the summary has an upper limit (``steer.max_deg = 30``), or ``.min`` and ``.max``.

    Raises:
        ValueError: one line, naming the key.
    """
    known = [f"{group}.{name}" for group in GROUPS for name in groups()[group].numbers]
    limits, own = dict[str, Limit](), dict[str, Any]()
    for key, value in table:
        path, _, side = key.rpartition(".")
        path, side = (path, side) if side in ("min", "max") else (key, "max")
        if key in _OWN:
            own[key] = value
        elif path not in known:
            raise ValueError(f"{place}: requirements.{shown(key)}{nearest(path, [*known, *_OWN])}")
        else:
            limit, number = limits.get(path, Limit(path)), _number(f"{place}: requirements.{key}", value)
            limits[path] = limit._replace(low=number) if side == "min" else limit._replace(high=number)
    times = {key: _positive(f"{place}: requirements.{key}", own[key]) for key in _OWN[1:] if key in own}
    return Requirements(
        limits=tuple(limits.values()),
        outcomes=_allowed(place, own.get(ALLOWED, ["completed"])),
        detect=times.get(DETECT),
        harmless_below=times.get(HARMLESS, 0.0),
        recover=times.get(RECOVER),
        recovered_below=times.get(BELOW, Requirements().recovered_below),
    )


def _allowed(place: str, values: Any) -> tuple[str, ...]:
    if not isinstance(values, list | tuple) or not values:
        raise ValueError(f"{place}: requirements.{ALLOWED} must be a list of {', '.join(OUTCOMES)}")
    for value in values:
        if value not in OUTCOMES:
            raise ValueError(f"{place}: requirements.{ALLOWED}: {shown(str(value))}{nearest(str(value), OUTCOMES)}")
    return tuple(values)


def _number(place: str, value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < _LARGEST:
        raise ValueError(f"{place} = {shown(str(value))} must be a number")
    return float(value)


def _positive(place: str, value: Any) -> float:
    number = _number(place, value)
    if number <= 0.0:
        raise ValueError(f"{place} = {number:g} must be above 0")
    return number
