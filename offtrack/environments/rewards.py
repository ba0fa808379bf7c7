"""Circumstances that episodes draw, with the vehicle varied by them; rewards, endings and running metrics.

Rewards and endings of trailer episodes are functions of ground truth at a moment.
"""

import numbers
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial, reduce
from typing import Any, ClassVar, Final, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from offtrack.environments.core import EnvironmentOptions, Info
from scenarios.loop.referee import FOLDED, LIFTED
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import symbolic_twin
from vehicle.foundation.user_file import nearest
from vehicle.frames import FloatArray


class Moment(NamedTuple):
    """Ground truth at one step, independent of the observation."""

    off_tracking: FloatArray  # (n,) of the last trailer, + if the path lies left of the follow point [m]
    curvature: FloatArray  # (n,) of the hitch path, + left [1/m]
    steer_rate: FloatArray  # (n, n_steered) of the trailer's axles, mean over the step [rad/s]
    articulation: FloatArray  # (n, N - 1) [rad]
    load_transfer: FloatArray  # (n, N) +-1: all load on one side's wheels
    road_offset: FloatArray  # (n,) of the tractor from its course, + left [m]
    speed: FloatArray  # (n,) of the tractor [m/s]
    finite: NDArray[np.bool_]  # (n,) False once the physics diverged
    clearance: FloatArray  # (n,) of all bodies from the road's edges, least; infinite without edges [m]


Reward = Callable[[Moment], FloatArray]  # (n,)
M = TypeVar("M", bound=tuple[Any, ...])  # a moment of trailers or rovers; its first field is (n,)

_MAX_ERROR = 3.0  # larger distances from the path cost no more: the trailer is off the road [m]
_KERB = 0.5  # free space to either side: a lane of 3.5 m and a trailer of 2.55 m [m]


def follow_error(moment: Moment) -> FloatArray:
    """Minus the square of the follow point's distance from the path [m2], up to 3 m."""
    distance = np.minimum(np.abs(moment.off_tracking), _MAX_ERROR)
    return -distance * distance


def off_path(moment: Moment) -> FloatArray:
    """Minus the follow point's distance from the path [m], up to 3 m: the cost is linear."""
    return -np.minimum(np.abs(moment.off_tracking), _MAX_ERROR)


def outside_path(moment: Moment) -> FloatArray:
    """Minus the follow point's distance from the path to the outside of the turn [m], up to 3 m."""
    outside = np.sign(moment.curvature) * moment.off_tracking  # path on the left in a left turn: outside
    distance: FloatArray = np.minimum(np.maximum(outside, 0.0), _MAX_ERROR)
    return -distance


def kerb(moment: Moment) -> FloatArray:
    """Minus 1 while the follow point is more than half a metre off the path: its wheels are on the kerb."""
    on_kerb: FloatArray = (np.abs(moment.off_tracking) > _KERB).astype(np.float64)
    return -on_kerb


def near_edge(moment: Moment) -> FloatArray:
    """Minus the distance by which the bodies are closer than half a metre to an edge of the road [m]."""
    return -np.minimum(np.maximum(_KERB - moment.clearance, 0.0), _MAX_ERROR)


def steer_effort(moment: Moment) -> FloatArray:
    """Minus the mean square of the trailer axles' steer rates [rad2/s2]."""
    rates = moment.steer_rate.T
    squares: FloatArray = reduce(np.add, rates * rates, np.zeros(rates.shape[1]))  # in the same order for any number n
    return -squares / len(rates)


def weighted(parts: Mapping[Callable[[M], FloatArray], float]) -> Callable[[M], FloatArray]:
    """Weighted sum of parts."""
    return partial(_sum, tuple(parts.items()))


def _sum(terms: tuple[tuple[Callable[[M], FloatArray], float], ...], moment: M) -> FloatArray:
    total = np.zeros(len(moment[0]))
    for part, weight in terms:
        total += weight * part(moment)
    return total


PARTS: Final = (follow_error, off_path, outside_path, kerb, near_edge, steer_effort)

# 0.1 m off the path costs 0.01 a step, 0.1 m to the outside another 0.01; axles at 6 deg/s cost 0.0002.
USUAL: Final[Mapping[Reward, float]] = {follow_error: 1.0, outside_path: 0.1, steer_effort: 0.02}
MISHAP: Final = -100.0  # once: as much as 200 steps at 0.7 m


Ending = Callable[[Moment], NDArray[np.bool_]]  # (n,)
_ROAD = 4.5  # half the width of a course's road [m]


def jackknifed(moment: Moment) -> NDArray[np.bool_]:
    """True at an articulation of 90 deg or more."""
    folded: NDArray[np.bool_] = np.logical_or.reduce(np.abs(moment.articulation) >= FOLDED, axis=1)
    return folded


def rolled_over(moment: Moment) -> NDArray[np.bool_]:
    """True if all load of a unit is on one side's wheels; a scenario waits until it falls."""
    lifted: NDArray[np.bool_] = np.logical_or.reduce(np.abs(moment.load_transfer) >= LIFTED, axis=1)
    return lifted


def left_the_road(moment: Moment) -> NDArray[np.bool_]:
    """True if the tractor's guided point is off its course by more than 4.5 m."""
    off_road: NDArray[np.bool_] = np.abs(moment.road_offset) > _ROAD
    return off_road


def over_the_edge(moment: Moment) -> NDArray[np.bool_]:
    """True if that, or if a body is over an edge of the road."""
    over: NDArray[np.bool_] = left_the_road(moment) | (moment.clearance < 0.0)
    return over


def diverged(moment: Moment) -> NDArray[np.bool_]:
    """True if the physics diverged."""
    return ~moment.finite


ENDINGS: Final[Mapping[str, Ending]] = {
    "jackknifed": jackknifed,
    "rolled over": rolled_over,
    "left the road": left_the_road,
    "diverged": diverged,
}


class RunningMetrics:
    """Off-tracking and steering of n episodes so far."""

    def __init__(self, n: int) -> None:
        """Begin with no steps."""
        self._steps, self._squares = np.zeros(n), np.zeros(n)
        self._largest, self._outside = np.zeros(n), np.zeros(n)
        self._steer, self._rate = np.zeros(n), np.zeros(n)
        self.newest = np.zeros(n)  # off-tracking [m]

    def begin(self, lanes: NDArray[np.intp]) -> None:
        """Begin episodes in these lanes."""
        for part in (self._steps, self._squares, self._largest, self._outside, self._steer, self._rate, self.newest):
            part[lanes] = 0.0

    def step(self, moment: Moment, angles: FloatArray) -> None:
        """Add a step, with the trailer's axles at angles (n, n_steered) [rad]."""
        error = moment.off_tracking
        if not moment.finite.all():
            error = np.where(moment.finite, error, 0.0)
        self.newest = error
        self._steps += 1.0
        self._squares += error * error
        np.fmax(self._largest, np.abs(error), out=self._largest)
        np.fmax(self._outside, -outside_path(moment), out=self._outside)
        np.fmax(self._steer, np.abs(angles).max(axis=1), out=self._steer)
        np.fmax(self._rate, np.abs(moment.steer_rate).max(axis=1), out=self._rate)

    def info(self) -> Info:
        """Metrics by their names in ``summary.json``; ``outside_max_m`` is the follow point's, in turns."""
        return {
            "off_tracking": self.newest.copy(),
            "true_rms_m": np.sqrt(self._squares / np.maximum(self._steps, 1.0)),
            "true_max_m": self._largest.copy(),
            "outside_max_m": self._outside.copy(),
            "steer_max_deg": np.degrees(self._steer),
            "steer_max_rate_deg_s": np.degrees(self._rate),
        }


_HUGE = 1e300
Range = tuple[float, float]  # lower and upper bound of a uniform distribution


def drawn_from(usual: Range, low: float, high: float) -> Any:
    """Field of a range within limits, in the unit of its comment."""
    return field(default=usual, metadata={"within": (low, high)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranges:
    """Ranges of an episode's circumstances, each declared by `drawn_from`.

    Raises:
        ValueError: if a range is empty or exceeds its limits.
    """

    def __post_init__(self) -> None:
        for declared in fields(self):
            bounds, (least, most) = getattr(self, declared.name), declared.metadata["within"]
            low, high = _range(declared.name, bounds if isinstance(bounds, Sequence) else None)
            if not least <= low <= high <= most:
                raise ValueError(f"{declared.name} = {low:g} .. {high:g} must be a range within {least:g} .. {most:g}")

    def values(self, uniform: FloatArray) -> FloatArray:
        """Values (..., n) from uniform numbers (..., n) within 0 .. 1, one for each range."""
        ranges = np.array([getattr(self, declared.name) for declared in fields(self)])
        values: FloatArray = ranges[:, 0] + uniform * (ranges[:, 1] - ranges[:, 0])
        return values


DEFAULT_VEHICLE: Final = "uk_longer_semitrailer"  # of trailers that are steered


@dataclass(frozen=True, slots=True, kw_only=True)
class Domain(Ranges):
    """Ranges of a combination's episodes."""

    friction: Range = drawn_from((0.2, 0.9), 0.05, 1.5)  # of tyre and ground: gritted ice to dry asphalt [-]
    cross_fall: Range = drawn_from((-0.025, 0.05), -0.2, 0.2)  # + falls from a roundabout's centre, or to the right [-]
    speed: Range = drawn_from((1.4, 5.6), 0.5, 35.0)  # 5 to 20 km/h; lower if a turn needs more friction [m/s]
    load: Range = drawn_from((0.4, 1.0), 0.1, 2.0)  # mass of the trailer, relative to its file [-]
    length: Range = drawn_from((0.85, 1.05), 0.5, 1.5)  # of the trailer, relative to its file [-]
    actuator_lag: Range = drawn_from((0.7, 1.5), 0.1, 10.0)  # of the trailer's steering, relative to its file [-]
    sensor_error: Range = drawn_from((0.5, 1.5), 0.0, 10.0)  # of surrogate and encoders, over the nominal error [-]

    def drawn(self, uniform: FloatArray) -> "Circumstances":
        """Circumstances of k episodes from uniform numbers (k, 7) within 0 .. 1, one column per field."""
        return Circumstances(*self.values(uniform).T)


class Circumstances(NamedTuple):
    """Circumstances of k episodes, (k,) each; fields as in ``Domain``."""

    friction: FloatArray
    cross_fall: FloatArray
    speed: FloatArray
    load: FloatArray
    length: FloatArray
    actuator_lag: FloatArray
    sensor_error: FloatArray


N_DRAWN = len(Circumstances._fields)

DomainT = TypeVar("DomainT", bound=Ranges)


def narrowed(domain: DomainT, options: Mapping[str, Any], others: tuple[str, ...] = ()) -> DomainT:
    """The domain with some ranges replaced by a number or two bounds; ``others`` are further valid options.

    Raises:
        ValueError: if an option is unknown, or a value exceeds its limits.
    """
    known = [declared.name for declared in fields(domain)]
    for name in options:
        if name not in known:
            raise ValueError(f"unknown option '{name:.80}'{nearest(name, (*known, *others))}")
    ranges = {name: _range(name, value) for name, value in options.items()}
    return replace(domain, **ranges)


def _range(name: str, value: Any) -> Range:
    bounds = value if isinstance(value, Sequence) and len(value) == 2 else (value, value)
    if not all(isinstance(bound, numbers.Real) and not isinstance(bound, bool) for bound in bounds):
        raise ValueError(f"option {name} = {value!r:.80} must be a number or two bounds")
    low, high = (float(min(max(bound, -_HUGE), _HUGE)) for bound in bounds)  # a whole number may exceed all floats
    return low, high


class EpisodeOptions(EnvironmentOptions):
    """Options with a domain and, where there is a choice, a reward; both also as plain values."""

    parts: ClassVar[Sequence[Callable[[Any], FloatArray]]] = ()  # of a reward, which their names stand for

    @classmethod
    def of(cls, given: dict[str, Any], environment: str) -> Self:
        """The options, with ``domain={"friction": (0.2, 0.4)}`` and ``reward={"follow_error": 1.0}`` understood.

        Raises:
            ValueError: one line naming the option, its value and what is allowed.
        """
        plain = dict(given)
        try:
            if isinstance(given.get("domain"), Mapping):
                plain["domain"] = narrowed(cls.model_fields["domain"].default, given["domain"])
            if isinstance(given.get("reward"), Mapping):
                plain["reward"] = {cls._part(part): weight for part, weight in given["reward"].items()}
        except ValueError as error:
            raise ValueError(f"{environment}: {error}") from None
        return super().of(plain, environment)

    @classmethod
    def _part(cls, part: Any) -> Any:
        """The part of a reward that a name stands for; anything else stays as it is."""
        known = {function.__name__: function for function in cls.parts}
        if isinstance(part, str) and part not in known:
            raise ValueError(f"reward: unknown part '{part:.80}'{nearest(part, known)}")
        return known[part] if isinstance(part, str) else part


class Variation:
    """Varied numbers of a vehicle: axles move with the trailer's end and keep their spacing."""

    def __init__(self, vehicle: Vehicle) -> None:
        """For the vehicle's last unit."""
        twin = symbolic_twin(vehicle)
        last = f"units.{len(vehicle.units) - 1}."
        index = {str(twin.symbols[k]): k for k in range(twin.symbols.numel())}
        self._nominal = twin.values
        self._mass, self._inertia = index[last + "mass"], index[last + "yaw_inertia"]
        self._roll = [index[name] for name in (last + "roll.inertia",) if name in index]
        self._lag = [index[name] for name in (last + "steering.lag",) if name in index]
        self._cg = index[last + "cg_x"]
        trailer = vehicle.units[-1]
        axles = range(len(trailer.axles))
        moved = [f"{last}axles.{k}.{name}" for k in axles for name in ("x", "ackermann_x")]
        self._moved = [index[name] for name in (*moved, last + "follow_x", last + "rear_x") if name in index]
        follow = trailer.follow_x or trailer.rear_x
        self._follow = -follow
        self._centre = -sum(axle.x for axle in trailer.axles) / len(trailer.axles)

    def follow_distance(self, drawn: Circumstances) -> FloatArray:
        """Hitch to follow point, (k,) [m]."""
        return self._follow * drawn.length

    def numbers(self, drawn: Circumstances) -> FloatArray:
        """Numbers (k, n_numbers) of these vehicles.

        The load keeps its relative position between hitch and axles, and so its distribution.
        """
        rows = np.tile(self._nominal, (len(drawn.load), 1))
        longer = (drawn.length - 1.0) * self._follow
        rows[:, self._moved] -= longer[:, None]
        rows[:, self._cg] *= 1.0 + longer / self._centre
        rows[:, self._mass] *= drawn.load
        rows[:, self._inertia] *= drawn.load * drawn.length**2
        rows[:, self._roll] *= drawn.load[:, None]
        rows[:, self._lag] *= drawn.actuator_lag[:, None]
        return rows
