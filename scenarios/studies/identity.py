"""Identity of a run: a hash of everything that its numbers depend on.

That is the resolved scenario with its seed, the content of every file that any of its values names, the user's own
modules with all that they import, offtrack's files, the versions of libraries, and the engine. Names of folders and
modification times do not count.

Files that a run opens although its scenario does not name them, such as a table that an own law reads, are seen when
they are opened: see ``opened_files``.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import re
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

from scenarios.results.file_names import is_file, texts
from scenarios.results.files import digest
from scenarios.results.run_inputs import is_import_path, named_modules
from vehicle.engine.compiler import compiler
from vehicle.own_code import package_folders

_DERIVED: Final = (".pyc", ".md")  # files of offtrack that no number depends on


def content(scenario: Mapping[str, Any], *, portable: bool = False) -> str:
    """Hash of a resolved scenario, of all files and modules that it names, and of the software.

    A ``portable`` one leaves the machine out: processor and compiler.
    """
    on = installed() if portable else software()
    return hashlib.sha256(json.dumps([_content(scenario), on], sort_keys=True).encode()).hexdigest()


def identity(content: str, seed: int) -> str:
    """Identity of a run of a scenario of this ``content``."""
    return hashlib.sha256(f"{content} {seed}".encode()).hexdigest()[:20]


def _content(node: Any) -> Any:
    """The scenario with the content of files and modules in the place of their names."""
    if isinstance(node, Mapping):
        return {key: _content(value) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_content(value) for value in node]
    files = _files_of(node) if isinstance(node, str) else {}
    name = str(node).rpartition(":")[2] if isinstance(node, str) and is_import_path(node) else ""
    return [name, {key: digest(file) for key, file in files.items()}] if files else node


def named_files(node: Any) -> set[Path]:
    """All files that values of a scenario name, and those of its own modules."""
    return {file for text in texts(node) for file in _files_of(text).values()}


def _files_of(text: str) -> dict[str, Path]:
    """Files that a value stands for: own modules by their names, or a file of data as "data"."""
    if is_import_path(text):
        return named_modules(text)
    return {"data": Path(text).resolve()} if is_file(text) else {}


def software() -> tuple[str, ...]:
    """Everything that computes: offtrack's files, versions of libraries, the engine with the machine's features."""
    return (*installed(), str(compiler()))


@cache
def installed() -> tuple[str, str]:
    """Hash of offtrack's files, and versions of Python and the libraries as JSON."""
    sha = hashlib.sha256()
    for folder in package_folders():
        for file in sorted(folder.rglob("*")):
            if file.suffix not in _DERIVED and file.is_file():
                sha.update(f"{folder.name}/{file.relative_to(folder).as_posix()} {digest(file)}\n".encode())
    lines = [line for line in importlib.metadata.requires("offtrack") or () if ";" not in line]  # without extras
    needed = {name for line in lines for name in re.findall(r"^[\w.-]+", line)}
    libraries = {name: importlib.metadata.version(name) for name in sorted(needed)}
    return sha.hexdigest(), json.dumps([sys.version, libraries])
