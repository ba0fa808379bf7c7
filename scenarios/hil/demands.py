"""Demands of a controller on a bench: their names, and the checks of what comes in."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from vehicle.parameter_file import nearest
from vehicle.user_file import shown

DRIVER: Final = "driver"
TICK_NAME: Final = "tick"  # of the signals that a message answers; it may lack
_QUARTER: Final = 0.5 * math.pi


class Demand(NamedTuple):
    """One demanded number."""

    name: str
    unit: str
    limit: float  # of its size
    default: float | None = None  # where a message lacks it; None: it must have it


class Demands(NamedTuple):
    """Numbers that belong together: those of the driver, or of one trailer. A message has all of them or none."""

    part: str  # "driver" or the trailer's name
    numbers: tuple[Demand, ...]


class Message(NamedTuple):
    """A message that passed the checks."""

    tick: int | None  # of the signals that it answers; None: it does not say
    values: Mapping[str, tuple[float, ...]]  # by part


def driver_demands() -> Demands:
    """Demands in place of the tractor's driver."""
    return Demands(
        DRIVER,
        (
            Demand("steer_demand", "rad", _QUARTER),
            Demand("acceleration_demand", "m/s2", 20.0),
            Demand("gear_demand", "-", 1.0, default=1.0),
        ),
    )


def trailer_demands(name: str, n_steered: int, *, is_last: bool) -> Demands:
    """Demands for the steered axles of a trailer; those of a trailer ahead of the last end with its name."""
    ending = "" if is_last else f"_{name}"
    axles = range(1, n_steered + 1)
    return Demands(name, tuple(Demand(f"steer_demand_{k}{ending}", "rad", _QUARTER) for k in axles))


def checked_message(numbers: Mapping[str, object], parts: Sequence[Demands]) -> Message:
    """Demands in a message of numbers by name.

    Raises:
        ValueError: one line with the name, the value and its limit.
    """
    known = {demand.name: demand for part in parts for demand in part.numbers}
    for name in numbers:
        if name != TICK_NAME and name not in known:
            raise ValueError(f"unknown demand '{shown(name, 40)}'{nearest(name, tuple(known))}")
    given = {name: _number(known[name], value) for name, value in numbers.items() if name != TICK_NAME}
    values = {part.part: _of_part(part, given) for part in parts if any(one.name in given for one in part.numbers)}
    if not values:
        raise ValueError("has no demand")
    return Message(_tick(numbers.get(TICK_NAME)), values)


def _number(demand: Demand, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= demand.limit:  # also NaN
        rule = f"a number within -{demand.limit:.4g} to {demand.limit:.4g} {demand.unit}"
        raise ValueError(f"{demand.name} = {shown(repr(value), 40)} must be {rule}")
    if demand.name == "gear_demand" and abs(value) != 1.0:
        raise ValueError(f"gear_demand = {value:g} must be 1 or -1")
    return float(value)


def _of_part(part: Demands, given: Mapping[str, float]) -> tuple[float, ...]:
    values = [given.get(one.name, one.default) for one in part.numbers]
    for one, value in zip(part.numbers, values, strict=True):
        if value is None:
            raise ValueError(f"{one.name} is missing")
    return tuple(value for value in values if value is not None)


def _tick(value: object) -> int | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"tick = {shown(repr(value), 40)} must be a whole number")
    return value
