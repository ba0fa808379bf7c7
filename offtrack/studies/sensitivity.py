"""Sensitivity of a study's numbers to its drawn keys: elementary effects (Morris) and Sobol indices, by SALib.

A design says which values are drawn: the table ``sensitivity`` stands in the place of ``sample``. Its points are shares
of the distributions, so an elementary effect is the change of a number while a key passes through its whole range.

Sources: Morris 1991, Factorial sampling plans for preliminary computational experiments; Saltelli et al. 2010, Variance
based sensitivity analysis of model output (first and total order as SALib has them).
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field

from offtrack.studies.case import MOST_CASES, Outcome, Settings
from offtrack.studies.table import QUANTITIES, Quantity
from vehicle.foundation.quantity import Frozen
from vehicle.frames import FloatArray

CONFIDENCE: Final = 0.95
NOT_COMPLETED: Final = Quantity(
    "not_completed", "not done", "-", 2, "max", "1 for a run that did not complete its course, 0 for others"
)
_LEAST: Final[Mapping[str, int]] = {"morris": 2, "sobol": 8}  # groups of runs that are complete
_RESAMPLES: Final = 1000  # of the bootstrap


class Sensitivity(Frozen):
    """Design of a sensitivity analysis: the table ``sensitivity`` of a study."""

    method: Literal["morris", "sobol"]
    trajectories: Annotated[int, Field(ge=2, le=MOST_CASES, strict=True)] | None = None  # of morris
    levels: Annotated[int, Field(ge=4, le=100, multiple_of=2, strict=True)] | None = None  # of morris
    samples: Annotated[int, Field(ge=8, le=MOST_CASES, strict=True)] | None = None  # of sobol
    seed: Annotated[int, Field(ge=0, lt=2**32, strict=True)] = 1

    @property
    def groups(self) -> int:
        """Number of trajectories (Morris) or of base samples (Sobol)."""
        return (self.trajectories or 0) if self.method == "morris" else (self.samples or 0)

    def runs_of_group(self, keys: int) -> int:
        """Runs of a trajectory, or of a base sample with one further run for each key."""
        return keys + (1 if self.method == "morris" else 2)

    def problem(self) -> str:
        """One line on numbers that do not fit the method; empty if they do."""
        given = {name for name in ("trajectories", "levels", "samples") if getattr(self, name) is not None}
        if self.method == "morris" and given - {"levels"} != {"trajectories"}:
            return "morris needs trajectories, and takes no samples"
        if self.method == "sobol" and given != {"samples"}:
            return "sobol needs samples, and takes neither trajectories nor levels"
        if self.samples is not None and self.samples & (self.samples - 1):
            return f"samples = {self.samples} must be a power of two"
        return ""

    def shares(self, keys: int) -> FloatArray:
        """Shares (runs, keys) between 0 and 1; the runs of a group follow one another.

        Raises:
            ValueError: one line, if SALib is not installed.
        """
        check_installed()
        if self.method == "morris":
            from SALib.sample import morris

            points = morris.sample(_problem(keys), self.groups, num_levels=self.levels or 4, seed=self.seed)
        else:
            from SALib.sample import sobol

            points = sobol.sample(_problem(keys), self.groups, calc_second_order=False, seed=self.seed)
        return np.asarray(points, dtype=np.float64)


class Index(NamedTuple):
    """Sensitivity of a number to a key: a first measure with half its 95 % interval, and a second one."""

    key: str
    first: float  # mu* (mean absolute effect), or the first-order index
    first_half_width: float
    second: float  # sigma (deviation of the effects), or the total index
    second_half_width: float | None = None  # None: not known


@dataclass(frozen=True, slots=True, kw_only=True)
class Analysis:
    """Sensitivity of one quantity at one point of the grid."""

    axes: Settings
    quantity: Quantity
    indices: tuple[Index, ...]  # empty if too few groups are complete, or the number does not vary
    groups: int  # that have all their runs
    left_out: tuple[str, ...]  # titles of runs without this number, whose groups are left out


def analysed(design: Sensitivity, outcomes: Sequence[Outcome]) -> list[Analysis]:
    """The analysis of each point and each quantity that some run has; and of not completing, if that happened."""
    points: dict[Settings, list[Outcome]] = {}
    for outcome in outcomes:
        points.setdefault(outcome.case.axes, []).append(outcome)
    return [one for axes, runs in points.items() for one in _of_point(design, axes, runs)]


def _of_point(design: Sensitivity, axes: Settings, runs: Sequence[Outcome]) -> Iterator[Analysis]:
    keys = [key for key, _ in runs[0].case.drawn]
    quantities = [q for q in QUANTITIES if any(run.number(q.path) is not None for run in runs)]
    if not all(run.completed for run in runs):
        quantities.append(NOT_COMPLETED)
    for quantity in quantities:
        values = np.array([_value(run, quantity) for run in runs])
        left_out = tuple(run.case.title for run, value in zip(runs, values, strict=True) if math.isnan(value))
        indices, groups = effects(design, keys, values)
        yield Analysis(axes=axes, quantity=quantity, indices=indices, groups=groups, left_out=left_out)


def _value(run: Outcome, quantity: Quantity) -> float:
    if quantity is NOT_COMPLETED:
        return float(not run.completed)
    number = run.number(quantity.path)
    return math.nan if number is None or not run.completed else number


def effects(design: Sensitivity, keys: Sequence[str], values: FloatArray) -> tuple[tuple[Index, ...], int]:
    """Indices of a number by key, and how many groups they rest on.

    Args:
        design: the design whose runs were made.
        keys: names of the keys, in the order of the design's columns.
        values: (runs,) in the order of the design's rows; NaN leaves out the group of its run.
    """
    size = design.runs_of_group(len(keys))
    complete = np.isnan(values.reshape(-1, size)).sum(axis=1) == 0
    groups, chosen = int(complete.sum()), np.repeat(complete, size)
    if groups < _LEAST[design.method] or np.ptp(values[chosen]) == 0.0:
        return (), groups
    problem, known = _problem(len(keys)), values[chosen]
    options: dict[str, Any] = {"num_resamples": _RESAMPLES, "conf_level": CONFIDENCE, "seed": design.seed}
    if design.method == "morris":
        from SALib.analyze import morris

        found = morris.analyze(
            problem, design.shares(len(keys))[chosen], known, num_levels=design.levels or 4, **options
        )
        names = ["mu_star", "mu_star_conf", "sigma"]
    else:
        from SALib.analyze import sobol

        found = sobol.analyze(problem, known, calc_second_order=False, **options)
        names = ["S1", "S1_conf", "ST", "ST_conf"]
    columns = [[float(value) for value in found[name]] for name in names]
    return tuple(Index(key, *numbers) for key, *numbers in zip(keys, *columns, strict=True)), groups


def _problem(keys: int) -> dict[str, Any]:
    return {"num_vars": keys, "names": [f"x{k}" for k in range(keys)], "bounds": [[0.0, 1.0]] * keys}


def check_installed() -> None:
    """Refuse to go on without the extra.

    Raises:
        ValueError: one line.
    """
    if importlib.util.find_spec("SALib") is None:
        raise ValueError("a sensitivity analysis needs SALib; install it with: pip install 'offtrack[sensitivity]'")


def plain(analysis: Analysis, method: str) -> dict[str, Any]:
    """An analysis for JSON."""
    names = MEASURES[method]
    return {
        "quantity": analysis.quantity.path,
        "unit": analysis.quantity.unit,
        "method": method,
        "groups": analysis.groups,
        "left_out": list(analysis.left_out),
        "keys": {index.key: dict(zip(names, index[1:], strict=True)) for index in analysis.indices},
    }


MEASURES: Final[Mapping[str, tuple[str, str, str, str]]] = {  # names of an index's numbers
    "morris": ("mu_star", "mu_star_half_width", "sigma", "sigma_half_width"),
    "sobol": ("first_order", "first_order_half_width", "total", "total_half_width"),
}
