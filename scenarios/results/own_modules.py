"""Modules of the user's own: neither offtrack's nor of an installed library."""

from __future__ import annotations

import ast
import importlib.util
import os
import sys
from collections.abc import Iterator
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

from vehicle.own_code import is_library


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
