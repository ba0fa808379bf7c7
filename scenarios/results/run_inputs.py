"""Inputs of a run: the files that its scenario names, and the user's own modules.

A run directory holds copies of the files, so that it runs again elsewhere, and after a file was edited. Modules are not
copied, as they belong to a program: their hashes are kept, and a later run on other ones says so.
"""

import ast
import importlib.util
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any, Final

import tomli_w

from scenarios.results.run_directory import digest
from vehicle.foundation.own_parts import is_library
from vehicle.foundation.user_file import FileKind, read_json, read_toml


def own_modules(name: str) -> dict[str, Path]:
    """Files by module name: this module and all own ones that it imports, also indirectly or inside functions.

    Imports are read from the source: nothing is executed.
    """
    found: dict[str, Path] = {}
    waiting = [name]
    while waiting:
        name = waiting.pop()
        file = None if name in found else _own_file(name)
        if file is not None:
            found[name] = file
            waiting += [name.rpartition(".")[0] or name, *_imports(name, file)]
    return found


def _own_file(name: str) -> Path | None:
    """File of a module; None if it is not the user's own, has none or does not exist."""
    spec = _spec(name)
    if spec is None or not spec.has_location or spec.origin is None:
        return None
    file = Path(spec.origin).resolve()
    return None if is_library(file) or not file.is_file() else file


def _spec(name: str) -> ModuleSpec | None:
    """Specification of a module, without importing its packages."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    head, *rest = name.split(".")
    try:
        spec = importlib.util.find_spec(head)
    except (ImportError, ValueError):  # a module without a specification, such as __main__
        return None
    for part in rest:
        if spec is None or spec.submodule_search_locations is None:
            return None
        head = f"{head}.{part}"
        spec = PathFinder.find_spec(head, spec.submodule_search_locations)
    return spec


def _imports(name: str, file: Path) -> Iterator[str]:
    """Names of all modules that a module's source may import."""
    if file.suffix != ".py":
        return
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError, RecursionError):
        return  # the run says what is wrong with it
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _with_parents(alias.name)
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: max(len(package.split(".")) - node.level + 1, 0)] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            yield from _with_parents(source)
            yield from (f"{source}.{alias.name}" for alias in node.names)


def _with_parents(name: str) -> Iterator[str]:
    parts = name.split(".")
    yield from (".".join(parts[:count]) for count in range(1, len(parts) + 1) if parts[0])


MAP_SUFFIX: Final = ".toml"  # after the name of an FMU: its map


def with_neighbours(scenario: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Scenario in which relative names of files in ``folder``, where it comes from, are absolute paths.

    A name without a suffix is that of a part or of shipped data, never of a file.
    """

    def found(text: str) -> str:
        relative = bool(Path(text).suffix) and not os.path.isabs(text)
        return str((folder / text).absolute()) if relative and is_file(folder / text) else text

    changed: dict[str, Any] = with_texts(scenario, found)
    return changed


def texts(node: Any) -> Iterator[str]:
    """All texts among the values of a scenario."""
    children = node.values() if isinstance(node, Mapping) else node if isinstance(node, list | tuple) else ()
    yield from (text for child in children for text in texts(child))
    if isinstance(node, str):
        yield node


def with_texts(node: Any, change: Callable[[str], str]) -> Any:
    """A scenario's tables and lists with all texts among their values changed."""
    if isinstance(node, Mapping):
        return {key: with_texts(value, change) for key, value in node.items()}
    if isinstance(node, list):
        return [with_texts(value, change) for value in node]
    return change(node) if isinstance(node, str) else node


def is_file(path: str | Path) -> bool:
    """True if a text is the name of a regular file."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError, RuntimeError):  # too long, a null character, links in a circle: not a file's name
        return False


def tyre_files(path: str, content: bytes | None = None) -> dict[str, str]:
    """Absolute paths of the tyre files that a vehicle's TOML file names, by the texts that name them."""
    if not path.endswith(".toml") or (content is None and not is_file(path)):
        return {}
    try:
        table = read_toml(Path(path)) if content is None else tomllib.loads(content.decode())
    except ValueError:  # the run says what is wrong with it
        return {}
    named = sorted({text for text in texts(table) if text.lower().endswith(".tir")})
    return {text: os.path.abspath(Path(path).parent / text) for text in named}


def renamed_tyres(path: str, content: bytes, names: Mapping[str, str]) -> bytes:
    """Content of a vehicle's file that goes to ``names[path]``, with the tyre files where they go by ``names``."""
    there = {text: names[full] for text, full in tyre_files(path, content).items() if full in names}
    if not there:
        return content
    new = {text: os.path.relpath(name, os.path.dirname(names[path])) for text, name in there.items()}
    return tomli_w.dumps(with_texts(tomllib.loads(content.decode()), lambda text: new.get(text, text))).encode()


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
    names += sorted({tyre for text in names if os.path.isabs(text) for tyre in tyre_files(text).values()})
    paths = [text for text in names if os.path.isabs(text) and is_file(text) and os.path.getsize(text) <= _LARGEST]
    return RunInputs({path: Path(path).read_bytes() for path in paths}, _module_hashes(names))


def write_inputs(scenario_toml: str, inputs: RunInputs, folder: Path) -> str:
    """Write copies of the files below ``folder``; return the scenario, which names the copies relative to it."""
    if not inputs.files:
        return scenario_toml
    (folder / _FOLDER).mkdir()
    names: dict[str, str] = {}
    for path in inputs.files:
        fmu = path.removesuffix(MAP_SUFFIX)
        name = f"{_FOLDER}/{Path(path).name}" if fmu not in names else names[fmu] + MAP_SUFFIX
        while name in names.values():
            name = f"{_FOLDER}/{len(names)}-{Path(path).name}"
        names[path] = name
    for path, content in inputs.files.items():
        (folder / names[path]).write_bytes(renamed_tyres(path, content, names))
    return tomli_w.dumps(with_texts(tomllib.loads(scenario_toml), lambda text: names.get(text, text)))


def changed_modules(file: Path, scenario: Mapping[str, Any]) -> tuple[str, ...]:
    """Own modules of a scenario that are not as they were when the run was made that its file belongs to."""
    try:
        kept = read_json(file.parent / "manifest.json", FileKind.RECORD)[_MODULES]
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
