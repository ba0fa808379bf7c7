"""Parameters to tune: declared by the law, or given on the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from scenarios.assembly.trailer_law import law_options
from scenarios.studies.study import settings_of
from scenarios.studies.tuning import Range
from vehicle.parameter_file import nearest


def defaults_of(law: Callable[..., object]) -> dict[str, float]:
    """Numeric parameters of a law's class with their defaults."""
    defaults = {option.name: option.default for option in law_options(law)}
    return {
        name: float(default)
        for name, default in defaults.items()
        if isinstance(default, int | float) and not isinstance(default, bool)
    }


def ranges_of(name: str, law: Callable[..., object], given: Sequence[str]) -> dict[str, Range]:
    """Search ranges by parameter: the given ones, NAME=LOW:HIGH, or else those that the law declares.

    Raises:
        ValueError: one line, for an unknown parameter, or if there is no range.
    """
    options = law_options(law)
    known = [option.name for option in options]
    ranges = {key: _range(text, key) for key, text in settings_of(given, "--range")}
    for parameter in ranges:
        if parameter not in known:
            raise ValueError(f"--range {parameter}: {name} has no such parameter{nearest(parameter, known)}")
    ranges = ranges or {
        option.name: Range(low=option.tune[0], high=option.tune[1]) for option in options if option.tune
    }
    if not ranges:
        raise ValueError(f"--controller {name}: declares no parameters to tune; use --range PARAMETER=LOW:HIGH")
    return ranges


def _range(text: str, parameter: str) -> Range:
    low, _, high = text.partition(":")
    try:
        return Range(low=float(low), high=float(high or "nan"))
    except ValueError as error:
        raise ValueError(f"--range {parameter}={text}: expected LOW:HIGH, two numbers, LOW below HIGH") from error
