"""Folders of offtrack's packages; check that no other folder hides them."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Final

_PACKAGES: Final = ("vehicle", "sensors", "estimators", "controllers", "scenarios")


def package_folders() -> tuple[Path, ...]:
    """Folders of offtrack's packages, by name."""
    return tuple(Path(__file__).resolve().parents[1] / name for name in sorted((*_PACKAGES, "offtrack")))


def check_packages() -> None:
    """Check that each of the five packages is offtrack's own.

    Raises:
        ImportError: one line, which says what hides what.
    """
    own = Path(__file__).resolve().parents[1]
    for name in _PACKAGES:
        spec = importlib.util.find_spec(name)
        found = None if spec is None or spec.origin is None else Path(spec.origin).resolve()
        if found is None:
            raise ImportError(f"offtrack's package {name} is missing in {own}: install offtrack again")
        if found.parents[1 if found.name == "__init__.py" else 0] != own:
            raise ImportError(f"{found} hides offtrack's package {name}: rename it, or work in another folder")
