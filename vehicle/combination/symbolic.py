"""A vehicle whose numbers are symbols, so that one set of compiled equations serves all vehicles built alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from pydantic import BaseModel

from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_WORDS = frozenset(["name", "summary"])  # fields that no equation looks at


class SymbolicTwin(NamedTuple):
    """A vehicle with a symbol for each of its numbers, and the numbers."""

    vehicle: Vehicle  # its numbers are ``casadi.SX``
    symbols: ca.SX  # (n,)
    values: FloatArray  # (n,)


def symbolic_twin(vehicle: Vehicle) -> SymbolicTwin:
    """The vehicle with a symbol, named after its place in the file, for every physical number."""
    symbols: list[ca.SX] = []

    def symbol(place: str, _: float) -> ca.SX:
        symbols.append(ca.SX.sym(place))
        return symbols[-1]

    twin = _with_numbers(vehicle, symbol)
    return SymbolicTwin(twin, ca.vertcat(ca.SX(0, 1), *symbols), numbers(vehicle))


def numbers(vehicle: Vehicle) -> FloatArray:
    """Every physical number of a vehicle, in the order of its symbols."""
    found: list[float] = []
    _with_numbers(vehicle, lambda _, value: found.append(value))
    return np.array(found)


def topology(vehicle: Vehicle) -> Vehicle:
    """The vehicle without its numbers and names: equal for vehicles that the same equations serve."""
    bare: Vehicle = _with_numbers(vehicle, lambda *_: 0.0, words=False)
    return bare


def _with_numbers(
    thing: Any,
    number: Callable[[str, float], Any],
    place: str = "",
    *,
    words: bool = True,
) -> Any:
    """A copy with every number replaced by ``number(place, value)``; not validated, for the numbers may be symbols."""

    def copied(part: Any, key: object) -> Any:
        return _with_numbers(part, number, f"{place}.{key}", words=words)

    if isinstance(thing, BaseModel):
        fields: dict[str, Any] = {
            name: "" if name in _WORDS and not words else copied(value, name) for name, value in thing
        }
        return type(thing).model_construct(**fields)
    if isinstance(thing, tuple | list):
        return type(thing)(copied(part, k) for k, part in enumerate(thing))
    if isinstance(thing, int | float) and not isinstance(thing, bool):
        return number(place.removeprefix("."), thing)
    return thing
