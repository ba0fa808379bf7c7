"""Headings of reports: what was run, and how it differs from the shipped scenario."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from scenarios.options.faults import FaultOptions
from scenarios.options.scenario import load_any_scenario, scenario_names
from vehicle.user_file import shown

_MOST: Final = 10  # changed keys that are listed
_LONGEST: Final = 60  # characters of a value


def scenario_facts(scenario: Mapping[str, Any]) -> str:
    """Vehicle, law and estimator of a resolved scenario, as a table."""
    if scenario.get("kind") == "rover":
        named = {"": "rover", "slip estimator ": "slip_estimator", "slip compensation ": "slip_compensation"}
    else:
        named = {"": "vehicle", "trailer steering ": "trailer_steering", "off-tracking ": "off_tracking"}
    facts = [f"{word}{_name(str(scenario[key]))}" for word, key in named.items() if key in scenario]
    if scenario.get("off_tracking") == "viso_ot":
        facts[-1] += f" ({scenario.get('odometry', 'keyframe')})"
    if fmu := scenario.get("plant", {}).get("fmu"):
        facts.append(f"plant {_name(fmu)}")
    return " · ".join(facts)


def changes(scenario: Mapping[str, Any]) -> str:
    """Keys of a resolved scenario that differ from the shipped one of its name, in one line; empty without any."""
    if scenario.get("name") not in scenario_names():
        return ""
    shipped_one = load_any_scenario(str(scenario["name"])).model_dump(mode="json", exclude_none=True)
    now, shipped = dict(_values(scenario)), dict(_values(shipped_one))
    keys = [key for key in {**now, **shipped} if now.get(key) != shipped.get(key)]
    listed = [f"{key} = {_text(now[key])}" if key in now else f"{key} not given" for key in keys[:_MOST]]
    more = f" and {len(keys) - _MOST} more" if len(keys) > _MOST else ""
    return f"Changed: {', '.join(listed)}{more}" if keys else ""


def _values(table: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _values(value, f"{before}{key}.")
        else:
            plain = list(value) if isinstance(value, tuple) else value
            yield f"{before}{key}", _faults(value) if key == "faults" else plain


def _faults(tables: Iterable[Mapping[str, Any]]) -> str:
    """Faults as ``--set`` takes them; a user's own kind need not be at hand any more."""
    return "; ".join(str(FaultOptions.model_construct(None, **table)) for table in tables) or "none"


def _text(value: Any) -> str:
    return shown(_name(value) if isinstance(value, str) else str(value), _LONGEST)


def _name(text: str) -> str:
    """The text; of a file its name without the folders."""
    return Path(text).name if "/" in text else text
