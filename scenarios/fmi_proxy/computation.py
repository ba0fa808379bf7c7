"""The Python side of an FMU: what it computes, and what it is opened from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """Everything that an FMU's process gets at its start."""

    folder: Path  # the FMU's resources
    settings: Mapping[str, Any]  # as the exporter wrote them
    parameters: Mapping[str, float]  # start values, as the importer has set them
    texts: Mapping[str, str]


class Computation(Protocol):
    """A model behind an FMU, stepped from communication point to communication point."""

    def step(self, tick: int, ticks: int, values: Mapping[str, float]) -> Mapping[str, float]:
        """Outputs [SI] at the end of a step over ``ticks`` that begins at ``tick`` with these inputs [SI]."""
        ...

    def text(self, name: str) -> str:
        """Value of an output that is a text."""
        ...

    def close(self) -> None:
        """Finish files and free what it holds."""
        ...


def moments(tick: int, ticks: int, period: int) -> range:
    """Multiples of a period from ``tick`` on, inside a step over ``ticks``."""
    return range(-(-tick // period) * period, tick + ticks, period)
