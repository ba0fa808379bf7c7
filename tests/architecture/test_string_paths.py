"""Paths of parts as text, ``module:Name``: no package names one of a package above it, and each is there."""

from __future__ import annotations

import ast
import importlib
import re
import tomllib
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[2]
CHAIN: Final = ("vehicle", "sensors", "estimators", "controllers", "scenarios", "offtrack")  # lowest first
PATH: Final = re.compile(rf"({'|'.join(CHAIN)})(\.\w+)+:\w+")


def paths(source: str) -> list[str]:
    """Texts of a module that are paths of parts."""
    texts = (node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant))
    return [text for text in texts if isinstance(text, str) and PATH.fullmatch(text)]


def upward(package: str, source: str) -> list[str]:
    """Paths in a module of a package that name a package above it."""
    return [path for path in paths(source) if CHAIN.index(path.partition(".")[0]) > CHAIN.index(package)]


@pytest.mark.slow
def test_no_package_names_a_part_of_a_package_above_it() -> None:
    sources = {file: file.read_text("utf-8") for package in CHAIN for file in (ROOT / package).rglob("*.py")}
    named = {file: upward(file.relative_to(ROOT).parts[0], source) for file, source in sources.items()}
    assert {str(file): names for file, names in named.items() if names} == {}
    assert sum(len(paths(source)) for source in sources.values()) > 50
    assert upward("scenarios", 'FMU = "offtrack.exchange.fmi_import.fmu_parts:law_of"')


@pytest.mark.slow
def test_every_path_leads_to_something() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    entries = [path for group in project["entry-points"].values() for path in group.values()]
    named = {path for package in CHAIN for file in (ROOT / package).rglob("*.py") for path in paths(file.read_text())}
    for path in (*named, *entries, *project["scripts"].values()):
        module, _, name = path.partition(":")
        assert hasattr(importlib.import_module(module), name), path
