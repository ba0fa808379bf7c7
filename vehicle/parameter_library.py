"""Parameter files of the package by name (vehicles, rovers, soils), and of a user by path."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from vehicle.parameter_file import nearest


@dataclass(frozen=True, slots=True)
class ParameterLibrary:
    """All parameter files of one kind."""

    kind: str  # noun for messages: "vehicle"
    folder: str  # in this package

    def names(self) -> tuple[str, ...]:
        """Names of the files, without suffix."""
        return tuple(sorted(path.stem for path in self._home().glob("*.toml")))

    def file(self, name_or_path: str) -> Path:
        """Path of the file of this name; a path that ends in ``.toml`` is returned as it is.

        Raises:
            ValueError: one line with the nearest known name.
        """
        if name_or_path.endswith(".toml"):
            return Path(name_or_path)
        known = self.names()
        if name_or_path not in known:
            hint = nearest(name_or_path, known)
            raise ValueError(f"unknown {self.kind} '{name_or_path}'{hint} (known: {', '.join(known)}; or a .toml file)")
        return self._home() / f"{name_or_path}.toml"

    def _home(self) -> Path:
        return Path(str(resources.files("vehicle"))) / self.folder
