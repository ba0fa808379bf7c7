"""Estimator interface, and the options that a replaceable part declares."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar

from vehicle.parameter_file import nearest

Parameter: TypeAlias = bool | int | float | str

Memory = TypeVar("Memory")
MessageT_contra = TypeVar("MessageT_contra", contravariant=True)
EstimateT_co = TypeVar("EstimateT_co", covariant=True)


class Estimator(Protocol[Memory, MessageT_contra, EstimateT_co]):
    """Recursive estimator without hidden state: everything it remembers is in the memory passed in and returned."""

    def init(self) -> Memory:
        """Memory before the first message."""

    def step(self, memory: Memory, message: MessageT_contra, /) -> tuple[Memory, EstimateT_co | None]:
        """Memory after the message, and the estimate at its tick if there is a new one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """One parameter of a replaceable part: default, unit, limits and a line of help."""

    name: str
    default: Parameter  # its type is the option's type; a float accepts an integer
    meaning: str
    unit: str = "-"
    low: float | None = None  # None: no lower limit
    high: float | None = None  # None: no upper limit

    def check(self, value: Parameter, key: str) -> None:
        """Check type and limits of a value.

        Raises:
            ValueError: one line with key, value, limits and unit.
        """
        kind = type(self.default)
        if type(value) is not kind and not (kind is float and type(value) is int):
            raise ValueError(f"{key} = {value!r} must be of type {kind.__name__}")
        if isinstance(value, bool | str):
            return
        low, high = -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high
        if not low <= value <= high:
            limits = f"{low:g} to {high:g}" if self.low is not None and self.high is not None else ""
            limits = limits or (f"at least {low:g}" if self.high is None else f"at most {high:g}")
            raise ValueError(f"{key} = {value!r} must be {limits} [{self.unit}]")


def option_values(options: Sequence[Option], given: Mapping[str, Parameter], prefix: str) -> dict[str, Parameter]:
    """Values of all options: the given ones, defaults for the rest.

    Raises:
        ValueError: one line that names ``prefix.name``, for an unknown option or a wrong value.
    """
    known = {option.name: option for option in options}
    for name, value in given.items():
        if name not in known:
            raise ValueError(f"unknown option '{prefix}.{name}'{nearest(name, tuple(known))}")
        known[name].check(value, f"{prefix}.{name}")
    return {name: given.get(name, option.default) for name, option in known.items()}
