"""Scenarios that offtrack ships, as files; reading them imports none of the parts that they name."""

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

FOLDER = Path(str(resources.files("scenarios") / "data"))


def scenario_names() -> tuple[str, ...]:
    """Names of the shipped scenarios."""
    return tuple(sorted(file.stem for file in FOLDER.glob("*.toml")))


def shipped_table(name: str) -> dict[str, Any]:
    """Content of a shipped scenario's file."""
    return tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
