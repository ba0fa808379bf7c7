"""Values drawn at random for the runs of a study: distributions over keys, and when there are enough draws."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field
from scipy.special import ndtri

from offtrack.studies.case import MOST_CASES, Case, Outcome, Settings
from offtrack.studies.sensitivity import Sensitivity
from vehicle.foundation.quantity import Frozen
from vehicle.foundation.user_file import shown
from vehicle.frames import FloatArray

Method = Literal["latin", "sobol", "random"]
_MOST_KEYS: Final = 50
_LARGEST: Final = 1e12  # number of a distribution
_CENTRAL: Final = 0.95  # share of an unbounded distribution that Morris' levels span


class Sample(Frozen):
    """How many values are drawn, and how: the table ``sample`` of a study."""

    count: Annotated[int, Field(ge=2, le=MOST_CASES, strict=True)]
    method: Method = "latin"  # Latin hypercube, scrambled Sobol sequence, or independent values
    seed: Annotated[int, Field(ge=0, strict=True)] = 1


class Distribution(NamedTuple):
    """A distribution of one key: a name of ``DISTRIBUTIONS``, and its numbers or values."""

    kind: str
    values: tuple[Any, ...]

    def text_at(self, share: float) -> str:
        """The value below which a share (0 to 1) of all values lies, as text of a setting."""
        if self.kind == "choice":
            return str(self.values[min(int(share * len(self.values)), len(self.values) - 1)])
        first, second = (float(value) for value in self.values)
        if self.kind == "uniform":
            return repr(first + share * (second - first))
        deviation = float(ndtri(min(max(share, 1e-9), 1.0 - 1e-9)))
        return repr(first + second * deviation if self.kind == "normal" else first * math.exp(second * deviation))


DISTRIBUTIONS: Final[Mapping[str, str]] = {
    "uniform": "[lowest, highest]",
    "normal": "[mean, standard deviation]",
    "lognormal": "[median, standard deviation of the logarithm]",
    "choice": "[value, value, ...], equally likely",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Draws:
    """Keys that are drawn, and their sample."""

    distributions: Mapping[str, Distribution] = field(default_factory=dict)
    sample: Sample | None = None
    sensitivity: Sensitivity | None = None  # in place of a sample

    def __bool__(self) -> bool:
        return bool(self.distributions)

    def settings(self) -> Iterator[Settings]:
        """Values of each draw; one empty draw if nothing is drawn."""
        if not self:
            yield ()
            return
        for shares in self._shares():
            yield tuple(
                (key, distribution.text_at(share))
                for (key, distribution), share in zip(self.distributions.items(), shares.tolist(), strict=True)
            )

    def _shares(self) -> FloatArray:
        """Shares (draws, keys) between 0 and 1."""
        if self.sensitivity is None:
            return _shares(self.sample, len(self.distributions)) if self.sample else np.empty((0, 0))
        shares = self.sensitivity.shares(len(self.distributions))
        if self.sensitivity.method == "morris":  # its lowest and highest levels are 0 and 1
            unbounded = [one.kind in ("normal", "lognormal") for one in self.distributions.values()]
            shares[:, unbounded] = 0.5 + _CENTRAL * (shares[:, unbounded] - 0.5)
        return shares

    def tables(self) -> dict[str, Any]:
        """The tables ``draw``, and ``sample`` or ``sensitivity``, of a study file."""
        if not self:
            return {}
        drawn = {key: {one.kind: list(one.values)} for key, one in self.distributions.items()}
        design = {"sample": self.sample, "sensitivity": self.sensitivity}
        return {name: one.model_dump(exclude_none=True) for name, one in design.items() if one} | {"draw": drawn}


def read_draws(
    path: str, sample: Sample | None, table: Sequence[tuple[str, Any]], sensitivity: Sensitivity | None = None
) -> Draws:
    """Draws of a study file from its table ``sample`` or ``sensitivity`` and the dotted keys of its table ``draw``.

    Raises:
        ValueError: one line, naming the key.
    """
    if sample is None and sensitivity is None and not table:
        return Draws()
    if sample is not None and sensitivity is not None:
        raise ValueError(f"study {path}: [sample] and [sensitivity]: choose one")
    if sensitivity is not None and (problem := sensitivity.problem()):
        raise ValueError(f"study {path}: sensitivity: {problem}")
    if (sample is None and sensitivity is None) or not table:
        missing = "[draw] with a distribution for each key" if not table else "[sample] with count, or [sensitivity],"
        raise ValueError(f"study {path}: a table {missing} is missing")
    distributions: dict[str, Distribution] = {}
    for dotted, values in table:
        key, _, kind = dotted.rpartition(".")
        place = f"study {path}: draw.{shown(dotted)}"
        if kind not in DISTRIBUTIONS or not key:
            raise ValueError(
                f"{place}: expected a distribution: {'; '.join(f'{k} = {v}' for k, v in DISTRIBUTIONS.items())}"
            )
        if key in distributions:
            raise ValueError(f"{place}: the key has two distributions")
        distributions[key] = Distribution(kind, _checked(place, kind, values))
    if len(distributions) > _MOST_KEYS:
        raise ValueError(f"study {path}: draw has {len(distributions)} keys: must be at most {_MOST_KEYS}")
    return Draws(distributions=distributions, sample=sample, sensitivity=sensitivity)


def _checked(place: str, kind: str, values: Any) -> tuple[Any, ...]:
    """Numbers or values of a distribution."""
    form = f"{place}: must be {DISTRIBUTIONS[kind]}"
    if not isinstance(values, list | tuple) or len(values) < 2:
        raise ValueError(form)
    if kind == "choice":
        if any(isinstance(value, dict | list | tuple) for value in values):
            raise ValueError(f"{form}: numbers, words or truth values")
        return tuple(str(value).lower() if isinstance(value, bool) else value for value in values)
    numbers = [value for value in values if isinstance(value, int | float) and not isinstance(value, bool)]
    if len(values) != 2 or len(numbers) != 2 or not all(abs(number) <= _LARGEST for number in numbers):
        raise ValueError(form)
    first, second = (float(number) for number in numbers)
    if (kind == "uniform" and not first < second) or (kind != "uniform" and not second > 0.0):
        raise ValueError(f"{form}, {'rising' if kind == 'uniform' else 'with a deviation above 0'}")
    if kind == "lognormal" and not first > 0.0:
        raise ValueError(f"{form}, with a median above 0")
    return (first, second)


def _shares(sample: Sample, keys: int) -> FloatArray:
    """Shares (count, keys) between 0 and 1."""
    rng = np.random.default_rng(sample.seed)
    if sample.method == "random":
        return rng.random((sample.count, keys))
    from scipy.stats import qmc  # half a second, which workers need not spend

    if sample.method == "latin":
        return np.asarray(qmc.LatinHypercube(keys, rng=rng).random(sample.count), dtype=np.float64)
    points = qmc.Sobol(keys, rng=rng).random_base2(math.ceil(math.log2(sample.count)))
    return np.asarray(points[: sample.count], dtype=np.float64)


Intervals = Callable[[Sequence[Outcome], Settings], Iterable[tuple[float, float]]]

_NARROWEST: Final = 1e-4
_WIDEST: Final = 0.5


class Stop(Frozen):
    """When a point of a study has enough draws: the table ``stop`` of a study."""

    half_width: Annotated[float, Field(ge=_NARROWEST, lt=_WIDEST)]  # of each limit's interval (Clopper-Pearson)
    batch: Annotated[int, Field(ge=2, le=MOST_CASES, strict=True)] = 50  # draws between two looks


def made_in_batches(
    cases: Sequence[Case],
    intervals: Intervals,
    stop: Stop,
    make: Callable[[Sequence[int]], Sequence[Outcome]],
) -> list[Outcome]:
    """Make the draws of each point batch by batch until its intervals are narrow; return outcomes in the cases' order.

    The looks come after fixed numbers of draws in a fixed order, so the study ends after the same draws whoever makes
    them, and as often as it is repeated.

    Args:
        cases: all runs of the study.
        intervals: of the probabilities that are looked at, from the outcomes so far and the axes of a point.
        stop: the rule.
        make: makes the runs with these indices and returns their outcomes.
    """
    points = _points(cases)
    done: dict[int, Outcome] = {}
    for first in range(0, max(map(len, points.values())), stop.batch):
        batch = [k for drawn in points.values() for k in drawn[first : first + stop.batch]]
        done |= zip(batch, make(batch), strict=True)
        outcomes = [done[k] for k in sorted(done)]
        points = {axes: drawn for axes, drawn in points.items() if not _is_known(intervals(outcomes, axes), stop)}
        if not points:
            break
    return [done[k] for k in sorted(done)]


def spared(cases: Sequence[Case], intervals: Intervals, stop: Stop, done: Mapping[int, Outcome]) -> set[int]:
    """Indices of the runs that need not be made, as far as the runs that are ``done`` (by their indices) tell."""
    spare: set[int] = set()
    for axes, drawn in _points(cases).items():
        for last in range(stop.batch, len(drawn), stop.batch):
            if not all(k in done for k in drawn[:last]):
                break
            if _is_known(intervals([done[k] for k in drawn[:last]], axes), stop):
                spare |= set(drawn[last:])
                break
    return spare


def _points(cases: Sequence[Case]) -> dict[Settings, list[int]]:
    """Indices of the runs of every point."""
    points: dict[Settings, list[int]] = {}
    for k, case in enumerate(cases):
        points.setdefault(case.axes, []).append(k)
    return points


def _is_known(intervals: Iterable[tuple[float, float]], stop: Stop) -> bool:
    """True if every interval is narrow enough."""
    return all(high - low <= 2.0 * stop.half_width for low, high in intervals)
