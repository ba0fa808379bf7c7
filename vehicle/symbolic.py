"""A vehicle whose numbers are symbols, so that one set of compiled equations serves all vehicles built alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from pydantic import BaseModel

from vehicle.description import Steering, Vehicle
from vehicle.frames import FloatArray

_WORDS = frozenset(["name", "summary"])  # fields that no equation looks at


class _Symbol(ca.SX):
    """A symbol that counts as given where the equations ask whether a number is (``hitch_height or 0.0``)."""

    def __bool__(self) -> bool:
        return True


class _Steering(Steering):
    """Steering whose degrees are symbols: ``math.radians`` takes none."""

    @property
    def limit(self) -> Any:
        """As of ``Steering``."""
        return self.limit_deg * (math.pi / 180.0)

    @property
    def rate_limit(self) -> Any:
        """As of ``Steering``."""
        return self.rate_limit_deg * (math.pi / 180.0)


class SymbolicTwin(NamedTuple):
    """A vehicle with a symbol for each of its numbers, and the numbers."""

    vehicle: Vehicle  # its numbers are ``casadi.SX``
    symbols: ca.SX  # (n,)
    values: FloatArray  # (n,)


def symbolic_twin(vehicle: Vehicle) -> SymbolicTwin:
    """The vehicle with a symbol, named after its place in the file, for every physical number."""
    symbols: list[ca.SX] = []

    def symbol(place: str, _: float) -> ca.SX:
        symbols.append(_Symbol(ca.SX.sym(place)))
        return symbols[-1]

    twin = _with_numbers(vehicle, symbol, kinds={Steering: _Steering})
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
    kinds: Mapping[type, type[BaseModel]] = MappingProxyType({}),
) -> Any:
    """A copy with every number replaced by ``number(place, value)``; not validated, for the numbers may be symbols."""

    def copied(part: Any, key: object) -> Any:
        return _with_numbers(part, number, f"{place}.{key}", words=words, kinds=kinds)

    if isinstance(thing, BaseModel):
        kind = kinds.get(type(thing), type(thing))
        fields: dict[str, Any] = {
            name: "" if name in _WORDS and not words else copied(value, name) for name, value in thing
        }
        return kind.model_construct(**fields)
    if isinstance(thing, tuple | list):
        return type(thing)(copied(part, k) for k, part in enumerate(thing))
    if isinstance(thing, int | float) and not isinstance(thing, bool):
        return number(place.removeprefix("."), thing)
    return thing
