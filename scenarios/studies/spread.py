"""Spread of a quantity over the runs of one point of a study, with confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.special import betaincinv, stdtrit

from scenarios.studies.case import Outcome, Settings
from scenarios.studies.table import Quantity
from vehicle.frames import FloatArray

CONFIDENCE: Final = 0.95


class Spread(NamedTuple):
    """Values of a quantity over the runs of a point."""

    axes: Settings
    values: FloatArray  # (n,) in the order of the draws, NaN for runs without a number

    @property
    def known(self) -> FloatArray:
        """The values that are numbers."""
        return self.values[np.isfinite(self.values)]


class Exceeding(NamedTuple):
    """How often a limit was exceeded, or a run did not end by completing its course."""

    beyond: int
    runs: int

    @property
    def share(self) -> float:
        """Share of the runs."""
        return self.beyond / self.runs

    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval of the probability."""
        tail, k, n = 0.5 * (1.0 - CONFIDENCE), self.beyond, self.runs
        low = 0.0 if k == 0 else float(betaincinv(k, n - k + 1, tail))
        high = 1.0 if k == n else float(betaincinv(k + 1, n - k, 1.0 - tail))
        return low, high


def spreads(outcomes: Sequence[Outcome], quantity: Quantity) -> list[Spread]:
    """The values of each point of the grid, in the order of the outcomes."""
    points: dict[Settings, list[float]] = {}
    for outcome in outcomes:
        number = outcome.number(quantity.path)
        points.setdefault(outcome.case.axes, []).append(math.nan if number is None else number)
    return [Spread(axes, np.array(values)) for axes, values in points.items()]


def exceeding(outcomes: Sequence[Outcome], axes: Settings, path: str, limit: float) -> Exceeding:
    """Runs of a point that exceeded a limit, were not completed, or have no number."""
    runs = [outcome for outcome in outcomes if outcome.case.axes == axes]
    numbers = [(outcome.completed, outcome.number(path)) for outcome in runs]
    return Exceeding(sum(not done or number is None or number > limit for done, number in numbers), len(runs))


def running_mean(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of the first 1, 2, ... n values, and the half width of its confidence interval (Student), (n,) each.

    The half width of one value is infinite. It holds for independent draws; for Latin hypercubes and Sobol sequences
    it is too wide.
    """
    count = np.arange(1, len(values) + 1)
    mean = np.cumsum(values) / count
    squares = np.cumsum(values**2) - count * mean**2
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.sqrt(np.maximum(squares, 0.0) / (count - 1))
        half = stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE) * deviation / np.sqrt(count)
    return mean, np.where(count > 1, half, np.inf)
