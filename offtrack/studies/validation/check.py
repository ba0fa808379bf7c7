"""Checks of numbers against targets, and their sections and plots."""

import math
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from typing import Final, Literal, NamedTuple, get_args

from vehicle.frames import FloatArray

Verdict = Literal["passed", "failed", "skipped"]
VERDICTS: Final = get_args(Verdict)


@dataclass(frozen=True, slots=True)
class Check:
    """A value that must lie within ``tolerance`` of ``target``."""

    name: str
    value: float | None  # None: not available; ``remark`` has the reason
    unit: str = ""
    _: KW_ONLY
    target: float = 0.0
    tolerance: float
    source: str  # of the target: a publication or a derivation
    remark: str = ""

    @property
    def verdict(self) -> Verdict:
        """Comparison of value and target; NaN fails."""
        if self.value is None:
            return "skipped"
        return "passed" if abs(self.value - self.target) <= self.tolerance else "failed"

    @property
    def used(self) -> float | None:
        """Deviation from the target over the tolerance [-]."""
        return None if self.value is None else abs(self.value - self.target) / self.tolerance


class Series(NamedTuple):
    """A curve or a set of points in a plot."""

    label: str
    x: FloatArray
    y: FloatArray
    style: Literal["model", "model points", "reference", "reference points", "faint"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plot:
    """A plot as data."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    to_scale: bool = False  # True: equal scales of both axes
    logarithmic: bool = False  # both axes


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckSection:
    """Related checks and their plots."""

    title: str
    text: str  # description, for readers who know vehicles but not this program
    checks: tuple[Check, ...]
    plots: tuple[Plot, ...] = ()


def tally(sections: Iterable[CheckSection]) -> dict[str, int]:
    """Number of checks with each verdict."""
    verdicts = [check.verdict for section in sections for check in section.checks]
    return {verdict: verdicts.count(verdict) for verdict in VERDICTS}


def number(value: float, tolerance: float) -> str:
    """A value with the digits that its tolerance makes meaningful; two digits if it is much smaller."""
    if not math.isfinite(value):
        return str(value)
    if abs(value) < max(0.1 * tolerance, 1e-4):
        return f"{value:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(tolerance)))
    return f"{value:.{min(decimals, 12)}f}"
