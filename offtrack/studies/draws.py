"""Values drawn at random for the runs of a study, when there are enough draws, and the sensitivity to them.

A sensitivity analysis has elementary effects (Morris) or Sobol indices, by SALib. Its design says which values are
drawn: the table ``sensitivity`` of a study stands in the place of ``sample``. Its points are shares of the
distributions, so an elementary effect is the change of a number while a key passes through its whole range.

Sources: Morris 1991, Factorial sampling plans for preliminary computational experiments; Saltelli et al. 2010, Variance
based sensitivity analysis of model output (first and total order as SALib has them).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import ndtri

from offtrack.studies.case import MOST_CASES, Case, Outcome, Settings
from offtrack.studies.table import QUANTITIES, Quantity, by_axes
from scenarios.extras import check_extra
from vehicle.foundation.quantity import Frozen
from vehicle.foundation.user_file import shown
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
        check_extra("sensitivity", "a sensitivity analysis needs", "SALib")
        from SALib.sample import morris, sobol

        if self.method == "morris":
            points = morris.sample(_problem(keys), self.groups, num_levels=self.levels or 4, seed=self.seed)
        else:
            points = sobol.sample(_problem(keys), self.groups, calc_second_order=False, seed=self.seed)
        return np.asarray(points, dtype=np.float64)


class Index(NamedTuple):
    """Sensitivity of a number to a key: a first measure with half its 95 % interval, and a second one."""

    key: str
    first: float  # mu* (mean absolute effect), or the first-order index
    first_half_width: float
    second: float  # sigma (deviation of the effects), or the total index
    second_half_width: float


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
    return [one for axes, runs in by_axes(outcomes).items() for one in _of_point(design, axes, runs)]


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
    size = len(keys) + (1 if design.method == "morris" else 2)  # runs of a trajectory, or of a base sample
    complete = np.isnan(values.reshape(-1, size)).sum(axis=1) == 0
    groups, chosen = int(complete.sum()), np.repeat(complete, size)
    if groups < _LEAST[design.method] or np.ptp(values[chosen]) == 0.0:
        return (), groups
    problem, known = _problem(len(keys)), values[chosen]
    from SALib.analyze import morris, sobol

    options: dict[str, Any] = {"num_resamples": _RESAMPLES, "conf_level": CONFIDENCE, "seed": design.seed}
    if design.method == "morris":
        found = morris.analyze(
            problem, design.shares(len(keys))[chosen], known, num_levels=design.levels or 4, **options
        )
        found["sigma_conf"] = _deviation_half_widths(design, values.reshape(-1, size)[complete], complete)
        names = ["mu_star", "mu_star_conf", "sigma", "sigma_conf"]
    else:
        found = sobol.analyze(problem, known, calc_second_order=False, **options)
        names = ["S1", "S1_conf", "ST", "ST_conf"]
    columns = [[float(value) for value in found[name]] for name in names]
    return tuple(Index(key, *numbers) for key, *numbers in zip(keys, *columns, strict=True)), groups


def _deviation_half_widths(design: Sensitivity, values: FloatArray, complete: NDArray[np.bool_]) -> FloatArray:
    """Half the interval of σ of each key by bootstrap, as SALib makes that of μ*; ``values`` (groups, keys + 1)."""
    keys = values.shape[1] - 1
    steps = np.diff(design.shares(keys).reshape(-1, keys + 1, keys)[complete], axis=1)  # (groups, keys, keys)
    moved = np.abs(steps).argmax(axis=2)  # the key of each step
    effects = np.zeros((len(values), keys))
    np.put_along_axis(
        effects, moved, np.diff(values, axis=1) / np.take_along_axis(steps, moved[:, :, None], 2)[:, :, 0], 1
    )
    drawn = np.random.default_rng(design.seed).integers(len(effects), size=(_RESAMPLES, len(effects)))
    deviations = effects[drawn].std(axis=1, ddof=1)
    half: FloatArray = float(ndtri(0.5 + 0.5 * CONFIDENCE)) * deviations.std(axis=0, ddof=1)
    return half


def _problem(keys: int) -> dict[str, Any]:
    return {"num_vars": keys, "names": [f"x{k}" for k in range(keys)], "bounds": [[0.0, 1.0]] * keys}


def analysis_json(analysis: Analysis, method: str) -> dict[str, Any]:
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


def number_of(place: str, value: Any) -> float:
    """The number of a key.

    Raises:
        ValueError: one line that begins with ``place``, if it is none, or out of all proportion.
    """
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < _LARGEST:
        raise ValueError(f"{place} = {shown(str(value))} must be a number")
    return float(value)


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
        distributions[key] = Distribution(kind, _checked_values(place, kind, values))
    if len(distributions) > _MOST_KEYS:
        raise ValueError(f"study {path}: draw has {len(distributions)} keys: must be at most {_MOST_KEYS}")
    return Draws(distributions=distributions, sample=sample, sensitivity=sensitivity)


def _checked_values(place: str, kind: str, values: Any) -> tuple[Any, ...]:
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
    cases: Sequence[Case], intervals: Intervals, stop: Stop, make: Callable[[Sequence[int]], Sequence[Outcome]]
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
    points: dict[Settings, list[int]] = {}
    for k, case in enumerate(cases):
        points.setdefault(case.axes, []).append(k)
    widest = 2.0 * stop.half_width
    done: dict[int, Outcome] = {}
    for first in range(0, max(map(len, points.values())), stop.batch):
        batch = [k for drawn in points.values() for k in drawn[first : first + stop.batch]]
        done |= zip(batch, make(batch), strict=True)
        outcomes = [done[k] for k in sorted(done)]
        points = {
            axes: drawn
            for axes, drawn in points.items()
            if any(high - low > widest for low, high in intervals(outcomes, axes))
        }
        if not points:
            break
    return [done[k] for k in sorted(done)]
