"""Keys of a scenario as keyword arguments."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from scenarios.options.rover import RoverScenario
from scenarios.options.scenario import Scenario, load_any_scenario


def load(
    scenario: str | os.PathLike[str], settings: Mapping[str, Any] | None, keys: Mapping[str, Any]
) -> Scenario | RoverScenario:
    """Load a scenario by name or file, with keys changed.

    Args:
        scenario: name of a shipped scenario, or a TOML file.
        settings: values by dotted keys, for example ``{"surface.friction": 0.3}``.
        keys: values by keys as Python names; two underscores stand for a dot: ``surface__friction=0.3``.

    Raises:
        TypeError: one line, if an argument is of another type.
        ValueError: one line that names key, value and limit.
    """
    if not isinstance(scenario, str | os.PathLike):
        raise TypeError(f"scenario must be a name or a TOML file, not {type(scenario).__name__}")
    if settings is not None and not isinstance(settings, Mapping):
        raise TypeError(f"settings must be a table of values by dotted keys, not {type(settings).__name__}")
    values = {**(settings or {}), **{key.replace("__", "."): value for key, value in keys.items()}}
    return load_any_scenario(os.fspath(scenario), [f"{key}={text_of(key, value)}" for key, value in values.items()])


def text_of(key: str, value: object) -> str:
    """A value as ``--set`` takes it.

    Raises:
        TypeError: one line, if no key has values of its type.
    """
    if isinstance(value, str | Path):
        return str(value)
    if isinstance(value, bool | int | float):
        return tomli_w.dumps({"value": value}).removeprefix("value = ").strip()
    if hasattr(value, "item") and getattr(value, "ndim", 1) == 0:  # a scalar of NumPy
        return text_of(key, value.item())
    if isinstance(value, list | tuple):
        return f"[{', '.join(_in_list(key, item) for item in value)}]"
    raise TypeError(f"{key} must be a text, a number, true or false, or a list of them, not {type(value).__name__}")


def _in_list(key: str, value: object) -> str:
    return json.dumps(str(value), ensure_ascii=False) if isinstance(value, str | Path) else text_of(key, value)
