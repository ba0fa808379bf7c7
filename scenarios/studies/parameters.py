"""The parameters that a law can be tuned in: what it says of them itself, or what it is told."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from scenarios.studies.study import settings_of
from scenarios.studies.tuning import Range
from vehicle.parameter_file import nearest


def defaults_of(law: Any) -> dict[str, float]:
    """The law's numeric parameters with their defaults."""
    signature = inspect.signature(law).parameters.values()
    return {
        p.name: float(p.default)
        for p in signature
        if isinstance(p.default, int | float) and not isinstance(p.default, bool)
    }


def ranges_of(name: str, law: Any, told: Sequence[str]) -> dict[str, Range]:
    """Where the parameters are looked for: as told, NAME=LOW:HIGH, else where the law's ``tunable`` says.

    Raises:
        ValueError: one line, for a parameter that the law does not have, or if nothing says where to look.
    """
    known = [p.name for p in inspect.signature(law).parameters.values()][1:]
    ranges = {key: _range(text, key) for key, text in settings_of(told, "--range")}
    for parameter in ranges:
        if parameter not in known:
            raise ValueError(f"--range {parameter}: {name} has no such parameter{nearest(parameter, known)}")
    own: Mapping[str, tuple[float, float]] = getattr(law, "tunable", {})
    found = ranges or {parameter: Range(low=low, high=high) for parameter, (low, high) in own.items()}
    if not found:
        raise ValueError(f"--controller {name}: it does not say what can be tuned; use --range PARAMETER=LOW:HIGH")
    return found


def _range(text: str, parameter: str) -> Range:
    low, colon, high = text.partition(":")
    try:
        return Range(low=float(low), high=float(high if colon else "nan"))
    except ValueError as error:
        raise ValueError(f"--range {parameter}={text}: expected LOW:HIGH, two numbers, LOW below HIGH") from error
