"""A table or figure of a paper, made again: own numbers beside the published ones, its data, and a picture."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib
from matplotlib.figure import Figure

from scenarios.report.drawing import STYLE
from scenarios.results.log import Log, write_log
from scenarios.results.run_directory import appearing_at_once
from scenarios.results.writer import versions

_DPI: Final = 150


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One number of the paper beside one's own."""

    quantity: str
    published: str  # as printed; "" where the paper has none
    own: float
    unit: str

    @property
    def own_text(self) -> str:
        """One's own as it is shown."""
        if not math.isfinite(self.own):
            return "–"
        return f"{self.own:.0f}" if abs(self.own) >= 100.0 else f"{self.own:.3g}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reproduction:
    """What came of it."""

    name: str
    title: str
    source: str
    comparisons: Sequence[Comparison]
    notes: Sequence[str]  # definitions, and how it differs from the paper's experiment
    data: Log
    draw: Callable[[], Figure]  # in the style of the house, see ``write_reproduction``
    interrupted: bool = False  # only a part of it is made

    def as_plain(self) -> dict[str, Any]:
        """For JSON: null stands for what could not be measured."""
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "notes": list(self.notes),
            "interrupted": self.interrupted,
            "numbers": [
                {
                    "quantity": one.quantity,
                    "published": one.published or None,
                    "own": one.own if math.isfinite(one.own) else None,
                    "unit": one.unit,
                }
                for one in self.comparisons
            ],
        }


def write_reproduction(made: Reproduction, directory: Path, facts: Mapping[str, Any]) -> None:
    """Writes picture (PNG), data (Parquet) and numbers (JSON, ``facts`` with them), all at once or not at all.

    Raises:
        ValueError: if the directory can not take them.
    """
    with appearing_at_once(directory) as folder:
        with matplotlib.rc_context(STYLE):
            made.draw().savefig(folder / f"{made.name}.png", dpi=_DPI)
        write_log(made.data, folder / f"{made.name}.parquet")
        content = {**made.as_plain(), **facts, "versions": versions()}
        text = json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False)
        (folder / f"{made.name}.json").write_text(text + "\n", encoding="utf-8")
