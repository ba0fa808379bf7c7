"""A number beside the one it should be, and what is shown around it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, get_args

from vehicle.frames import FloatArray

Verdict = Literal["passed", "failed", "skipped"]
VERDICTS: Final = get_args(Verdict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A value that has to lie within ``tolerance`` of ``target``."""

    name: str
    value: float | None  # None: it could not be had here, and ``remark`` says why
    target: float
    tolerance: float
    unit: str
    source: str  # of the target: where it stands, or what it follows from
    remark: str = ""

    @property
    def verdict(self) -> Verdict:
        """Whether the value is as it should be; what is not a number is not."""
        if self.value is None:
            return "skipped"
        return "passed" if abs(self.value - self.target) <= self.tolerance else "failed"

    @property
    def used(self) -> float | None:
        """Share of the tolerance that the value uses."""
        return None if self.value is None else abs(self.value - self.target) / self.tolerance


class Series(NamedTuple):
    """Points of a plot, joined or not."""

    label: str
    x: FloatArray
    y: FloatArray
    style: Literal["model", "model points", "reference", "reference points", "faint"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plot:
    """What to draw, as data."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    to_scale: bool = False  # one metre is as long up as across
    logarithmic: bool = False  # both axes


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """What belongs together: its checks, and plots of them."""

    title: str
    text: str  # what was done, for readers who know vehicles but not this program
    checks: tuple[Check, ...]
    plots: tuple[Plot, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A section still to be worked out."""

    title: str
    work: Callable[[bool], Section]  # given whether it has to be quick


def tally(sections: Iterable[Section]) -> dict[str, int]:
    """How many checks ended how."""
    verdicts = [check.verdict for section in sections for check in section.checks]
    return {verdict: verdicts.count(verdict) for verdict in VERDICTS}


def number(value: float, tolerance: float) -> str:
    """A value with the digits that its tolerance makes meaningful; one that is small beside it with two digits."""
    if not math.isfinite(value):
        return str(value)
    if abs(value) < max(0.1 * tolerance, 1e-4):
        return f"{value:.2g}"
    decimals = max(0, 1 - math.floor(math.log10(tolerance)))
    return f"{value:.{min(decimals, 12)}f}"
