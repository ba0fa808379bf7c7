"""Circumstances of episodes: their ranges, the values drawn from them, and the vehicle varied by them."""

from __future__ import annotations

import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from vehicle.combination.description import Vehicle
from vehicle.combination.functions import symbolic_twin
from vehicle.foundation.parameter_file import nearest
from vehicle.frames import FloatArray

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

    def drawn(self, uniform: FloatArray) -> Circumstances:
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
            raise ValueError(f"unknown reset option '{name:.80}'{nearest(name, (*known, *others))}")
    ranges = {name: _range(name, value) for name, value in options.items()}
    return replace(domain, **ranges)


def _range(name: str, value: Any) -> Range:
    bounds = value if isinstance(value, Sequence) and len(value) == 2 else (value, value)
    if not all(isinstance(bound, numbers.Real) and not isinstance(bound, bool) for bound in bounds):
        raise ValueError(f"option {name} = {value!r:.80} must be a number or two bounds")
    low, high = (float(min(max(bound, -_HUGE), _HUGE)) for bound in bounds)  # a whole number may exceed all floats
    return low, high


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
