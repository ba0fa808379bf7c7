"""Declared parameters of a replaceable part: default, unit, limits and meaning."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from vehicle.foundation.parameter_file import nearest
from vehicle.foundation.user_file import shown

Parameter: TypeAlias = bool | int | float | str


@dataclass(frozen=True, slots=True)
class Option:
    """One parameter of a replaceable part, such as a steering law or an estimator."""

    name: str
    default: Parameter | None  # None: required, or derived by the part; ``default_text`` says which
    meaning: str  # one line
    unit: str = "-"
    low: float = -math.inf
    high: float = math.inf
    tune: tuple[float, float] | None = None  # range that `offtrack tune` searches; None: not tuned
    choices: tuple[str, ...] = ()  # of a text; none: any text
    type_without_default: type[object] = float
    default_text: str = ""

    @property
    def kind(self) -> type[object]:
        """Type of the values; a float accepts an integer."""
        return self.type_without_default if self.default is None else type(self.default)

    @property
    def limits(self) -> str:
        """Limits with their unit, for messages and help: ``between 0 and 2 rad/m``; empty without limits."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"between {self.low:g} and {self.high:g}{unit}"
        if math.isfinite(self.low):
            return f"at least {self.low:g}{unit}"
        return f"at most {self.high:g}{unit}" if math.isfinite(self.high) else ""

    def check(self, value: Parameter, key: str) -> None:
        """Check type, choices and limits of a value.

        Raises:
            ValueError: one line with key, value, limits and unit.
        """
        unit = "" if self.unit == "-" else f" {self.unit}"
        accepted = (int, float) if self.kind is float else self.kind
        if not isinstance(value, accepted) or (isinstance(value, bool) and self.kind in (int, float)):
            kind = f"of type {self.kind.__name__}" if self.kind is not float or not self.limits else ""
            rule = ", ".join(filter(None, (self.limits, kind)))
            raise ValueError(f"{key} = {shown(repr(value))}{unit} must be {rule}")
        if isinstance(value, str):
            if self.choices and value not in self.choices:
                raise ValueError(f"{key} = '{shown(value)}'{nearest(value, self.choices)}")
        elif not (self.low <= value <= self.high and -math.inf < value < math.inf):  # whole numbers exceed floats
            raise ValueError(f"{key} = {shown(str(value))}{unit} must be {self.limits or 'finite'}")


def check_options(options: Sequence[Option], given: Mapping[str, Parameter], prefix: str = "") -> None:
    """Check that the given values belong to options and keep their limits.

    Args:
        options: of one part.
        given: values by name.
        prefix: of the names in messages: ``prefix.name``; empty: the name alone.

    Raises:
        ValueError: one line that names the first unknown option, or the first wrong value with its limits and unit.
    """
    known = {option.name: option for option in options}
    for name, value in given.items():
        key = f"{prefix}.{name}" if prefix else name
        if name not in known:
            raise ValueError(f"unknown option '{shown(key)}'{nearest(name, tuple(known))}")
        known[name].check(value, key)


def option_values(options: Sequence[Option], given: Mapping[str, Parameter], prefix: str) -> dict[str, Parameter]:
    """Values of all options: the given ones, and the others' defaults; those without either are left out.

    Raises:
        ValueError: as `check_options`.
    """
    check_options(options, given, prefix)
    defaults = {option.name: option.default for option in options if option.default is not None}
    return {**defaults, **given}


def declared_options(part: Callable[..., object], skip: Collection[str] = ()) -> tuple[Option, ...]:
    """Options of a part's class: its ``options``, or else what its constructor's signature shows.

    Args:
        part: class, constructed with one positional argument and keywords.
        skip: keywords that are no options.
    """
    declared = getattr(part, "options", None)
    if isinstance(declared, tuple) and all(isinstance(option, Option) for option in declared):
        return declared
    keywords = [
        p for p in inspect.signature(part).parameters.values() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
    ]
    return tuple(_undeclared(keyword) for keyword in keywords[1:] if keyword.name not in skip)


def _undeclared(keyword: inspect.Parameter) -> Option:
    """Option that any value is accepted for."""
    default = keyword.default
    if isinstance(default, int | float) and not isinstance(default, bool):
        return Option(keyword.name, float(default), "")
    text = "required" if default is keyword.empty else repr(default)
    return Option(keyword.name, None, "", type_without_default=object, default_text=text)
