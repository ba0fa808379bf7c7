"""The scenario of a sensor or driver inside its FMU, with copies of all files that it names."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from scenarios.options.scenario import Scenario, load_scenario
from scenarios.results.run_inputs import run_inputs, write_inputs

_FILE: Final = "scenario.toml"


def scenario_files(scenario: Scenario, changes: Mapping[str, Any]) -> dict[str, bytes]:
    """Resources of an FMU: the scenario with other values, and its files.

    Raises:
        ValueError: one line, if the scenario is not consistent.
    """
    changed = scenario.model_copy(update=dict(changes))
    inputs = run_inputs(changed.model_dump(exclude_none=True))
    with tempfile.TemporaryDirectory(prefix="offtrack-fmu-") as name:
        folder = Path(name)
        (folder / _FILE).write_text(write_inputs(changed.to_toml(), inputs, folder), encoding="utf-8")
        return {
            str(file.relative_to(folder).as_posix()): file.read_bytes()
            for file in sorted(folder.rglob("*"))
            if file.is_file()
        }


def scenario_in(folder: Path) -> Scenario:
    """The scenario among the resources of an FMU.

    Raises:
        ValueError: one line, if this offtrack does not understand it.
    """
    return load_scenario(str(folder / _FILE))
