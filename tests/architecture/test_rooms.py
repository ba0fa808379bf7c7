"""The READMEs of the rooms: what they say of files and of imports is so."""

import ast
import importlib
import re
import tomllib
from collections import defaultdict
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[2]
ROOMS: Final = ("vehicle", "sensors", "estimators", "controllers", "scenarios", "offtrack")
ROW: Final = re.compile(r"^\| (`[^|]*`) \|(?:.*\|)?([^|]*)\|$", re.MULTILINE)  # first and last cell
MODULE: Final = re.compile(r"`([\w/]+\.py)`")
MOST_ENTRIES: Final = 30  # of a folder; longer lists are not read


def text_of(room: str) -> str:
    return (ROOT / room / "README.md").read_text(encoding="utf-8")


def rows(room: str) -> dict[str, set[str]]:
    """Folders of the tables of a README, each with the names in the last column."""
    named = {
        name.strip("/"): cell for cells, cell in ROW.findall(text_of(room)) for name in re.findall(r"`([\w/]+)`", cells)
    }
    return {name: set(re.findall(r"`(\w+)`", cell)) for name, cell in named.items()}


def uses(room: str) -> dict[str, set[str]]:
    """Folders of a room with the other folders of the room that they import."""
    found: dict[str, set[str]] = defaultdict(set)
    for path in (ROOT / room).rglob("*.py"):
        folder, *rest = path.relative_to(ROOT / room).parts
        if not rest:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for module in modules:
                top, *inner = module.split(".")
                if top == room and inner and (ROOT / room / inner[0]).is_dir():
                    found[folder].add(inner[0])
    return {folder: others - {folder} for folder, others in found.items()}


@pytest.mark.parametrize("room", ROOMS)
def test_every_folder_is_in_the_table_of_its_room(room: str) -> None:
    there = {path.parent.name for path in (ROOT / room).glob("*/__init__.py")}
    assert there <= set(rows(room))


@pytest.mark.parametrize("room", ["scenarios", "offtrack"])
def test_the_column_of_uses_is_what_the_folders_import(room: str) -> None:
    stated = {folder: others for folder, others in rows(room).items() if others}
    assert stated == {folder: others for folder, others in uses(room).items() if others}


@pytest.mark.parametrize("room", ROOMS)
def test_every_module_that_a_readme_names_exists(room: str) -> None:
    """By its path in the room, or by its name alone if only one has it."""
    there = [str(path.relative_to(ROOT / room)) for path in (ROOT / room).rglob("*.py")]
    named = set(MODULE.findall(re.sub(r"```.*?```", "", text_of(room), flags=re.DOTALL)))
    missing = [name for name in named if not any(f"/{path}".endswith(f"/{name}") for path in there)]
    assert [name for name in missing if not (ROOT / name).exists()] == []


def test_no_folder_is_long() -> None:
    """Folders of data may be."""
    counts = {
        str(folder.relative_to(ROOT)): sum(entry.name != "__pycache__" for entry in folder.iterdir())
        for room in (*ROOMS, "tests")
        for folder in (ROOT / room, *(ROOT / room).rglob("*"))
        if folder.is_dir() and "__pycache__" not in folder.parts and "data" not in folder.parts
    }
    assert {folder: count for folder, count in counts.items() if count > MOST_ENTRIES} == {}


# Paths of parts as text, ``module:Name``: no package names one of a package above it, and each is there


PATH: Final = re.compile(rf"({'|'.join(ROOMS)})(\.\w+)+:\w+")


def paths(source: str) -> list[str]:
    """Texts of a module that are paths of parts."""
    texts = (node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Constant))
    return [text for text in texts if isinstance(text, str) and PATH.fullmatch(text)]


def upward(package: str, source: str) -> list[str]:
    """Paths in a module of a package that name a package above it."""
    return [path for path in paths(source) if ROOMS.index(path.partition(".")[0]) > ROOMS.index(package)]


@pytest.mark.slow
def test_no_package_names_a_part_of_a_package_above_it() -> None:
    sources = {file: file.read_text("utf-8") for package in ROOMS for file in (ROOT / package).rglob("*.py")}
    named = {file: upward(file.relative_to(ROOT).parts[0], source) for file, source in sources.items()}
    assert {str(file): names for file, names in named.items() if names} == {}
    assert sum(len(paths(source)) for source in sources.values()) > 50
    assert upward("scenarios", 'FMU = "offtrack.exchange.fmi_import.fmu_parts:law_of"')


@pytest.mark.slow
def test_every_path_leads_to_something() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    entries = [path for group in project["entry-points"].values() for path in group.values()]
    named = {path for package in ROOMS for file in (ROOT / package).rglob("*.py") for path in paths(file.read_text())}
    for path in (*named, *entries, *project["scripts"].values()):
        module, _, name = path.partition(":")
        assert hasattr(importlib.import_module(module), name), path
