"""Vehicles whose numbers are symbols: one set of compiled equations serves all vehicles of one topology."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from pydantic import BaseModel

from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_WORDS = frozenset(["name", "summary"])  # fields that no equation depends on
_IDLE = frozenset(["payload"])  # tables that no equation depends on


class SymbolicTwin(NamedTuple):
    """A vehicle with a symbol for each of its numbers, and the numbers."""

    vehicle: Vehicle  # its numbers are ``casadi.SX``
    symbols: ca.SX  # (n,)
    values: FloatArray  # (n,)


def symbolic_twin(vehicle: Vehicle) -> SymbolicTwin:
    """The vehicle with a symbol for every physical number, named by its path in the file."""
    symbols: list[ca.SX] = []

    def symbol(path: str, _: float) -> ca.SX:
        symbols.append(ca.SX.sym(path))
        return symbols[-1]

    twin = _with_numbers(vehicle, symbol)
    return SymbolicTwin(twin, ca.vertcat(ca.SX(0, 1), *symbols), numbers(vehicle))


def numbers(vehicle: Vehicle) -> FloatArray:
    """Every physical number of a vehicle, in the order of its symbols."""
    values: list[float] = []
    _with_numbers(vehicle, lambda _, value: values.append(value))
    return np.array(values)


@lru_cache(maxsize=64)
def topology(vehicle: Vehicle) -> Vehicle:
    """The vehicle without numbers and names: equal for vehicles with the same equations."""
    bare: Vehicle = _with_numbers(vehicle, lambda *_: 0.0, words=False)
    return bare


def _with_numbers(
    thing: Any,
    number: Callable[[str, float], Any],
    path: str = "",
    *,
    words: bool = True,
) -> Any:
    """A copy with every number replaced by ``number(path, value)``; not validated, as numbers may be symbols."""

    def copied(part: Any, key: object) -> Any:
        return _with_numbers(part, number, f"{path}.{key}", words=words)

    if isinstance(thing, BaseModel):
        fields: dict[str, Any] = {
            name: "" if name in _WORDS and not words else None if name in _IDLE else copied(value, name)
            for name, value in thing
        }
        return type(thing).model_construct(**fields)
    if isinstance(thing, tuple | list):
        return type(thing)(copied(part, k) for k, part in enumerate(thing))
    if isinstance(thing, int | float) and not isinstance(thing, bool):
        return number(path.removeprefix("."), thing)
    return thing
