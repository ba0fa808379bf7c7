"""Inputs of a run: the files that its scenario names, and the user's own modules.

A run directory holds copies of the files, so that it runs again elsewhere, and after a file was edited. Modules are not
copied, as they belong to a program: their hashes are kept, and a later run on other ones says so.
"""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import tomli_w

from scenarios.results.file_names import MAP_SUFFIX, is_file, texts, with_texts
from scenarios.results.files import digest
from scenarios.results.own_modules import own_modules
from vehicle.user_file import FileKind, read_text

_FOLDER: Final = "inputs"
_LARGEST: Final = 64_000_000  # file that is copied; a larger one is still named by its path [bytes]
_IMPORT_PATH: Final = re.compile(r"([A-Za-z_][\w.]*):[A-Za-z_]\w*")
_MODULES: Final = "own_modules"


@dataclass(frozen=True, slots=True)
class RunInputs:
    """Content of the files that a scenario names, and hashes of the own modules, as they were at the start."""

    files: Mapping[str, bytes] = field(default_factory=dict)  # by the text that names them in the resolved scenario
    modules: Mapping[str, str] = field(default_factory=dict)  # SHA-256 by the module's name


def run_inputs(scenario: Mapping[str, Any]) -> RunInputs:
    """Inputs of a resolved scenario, whose values name files by absolute paths and classes as ``module:Name``."""
    names = sorted(set(texts(scenario)))
    names += [text + MAP_SUFFIX for text in names if text.endswith(".fmu")]
    paths = [text for text in names if os.path.isabs(text) and is_file(text) and os.path.getsize(text) <= _LARGEST]
    return RunInputs({path: Path(path).read_bytes() for path in paths}, _module_hashes(names))


def write_inputs(scenario_toml: str, inputs: RunInputs, folder: Path) -> str:
    """Write copies of the files below ``folder``; return the scenario, which names the copies relative to it."""
    if not inputs.files:
        return scenario_toml
    (folder / _FOLDER).mkdir()
    names: dict[str, str] = {}
    for path, content in inputs.files.items():
        fmu = path.removesuffix(MAP_SUFFIX)
        name = f"{_FOLDER}/{Path(path).name}" if fmu not in names else names[fmu] + MAP_SUFFIX
        while name in names.values():
            name = f"{_FOLDER}/{len(names)}-{Path(path).name}"
        (folder / name).write_bytes(content)
        names[path] = name
    return tomli_w.dumps(with_texts(tomllib.loads(scenario_toml), lambda text: names.get(text, text)))


def changed_modules(file: Path, scenario: Mapping[str, Any]) -> tuple[str, ...]:
    """Own modules of a scenario that are not as they were when the run was made that its file belongs to."""
    try:
        kept = json.loads(read_text(file.parent / "manifest.json", FileKind.RECORD))[_MODULES]
        now = _module_hashes(texts(scenario))
        return tuple(sorted(name for name, sha in now.items() if kept.get(name, sha) != sha))
    except (OSError, ValueError, LookupError, TypeError, AttributeError):  # the scenario is not that of a run
        return ()


def manifest_entry(inputs: RunInputs) -> dict[str, dict[str, str]]:
    """Entry of a manifest; empty without own modules."""
    return {_MODULES: dict(inputs.modules)} if inputs.modules else {}


def _module_hashes(names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of the own modules that texts stand for, by the modules' names."""
    modules = {name: file for text in names for name, file in named_modules(text).items()}
    return {name: digest(file) for name, file in modules.items()}


def is_import_path(text: str) -> bool:
    """True if a text has the form ``module:Name``."""
    return _IMPORT_PATH.fullmatch(text) is not None


def named_modules(text: str) -> dict[str, Path]:
    """Own modules by name that an import path ``module:Name`` stands for; none for any other text."""
    match = _IMPORT_PATH.fullmatch(text)
    return own_modules(match[1]) if match else {}
