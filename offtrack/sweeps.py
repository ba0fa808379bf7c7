"""Grids of runs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from offtrack.runs import checked_seed, pandas, shown_progress, text_of
from offtrack.studies.pool import RunOptions
from offtrack.studies.run_study import run_study
from offtrack.studies.study import Study, load_study
from offtrack.studies.table import Row, shown_quantities
from scenarios.processes import default_jobs

if TYPE_CHECKING:
    from pandas import DataFrame


class Sweep:
    """A finished study: a row for each point of the grid, over all seeds.

    Attributes:
        rows: axes, number of runs and of completed runs, and numbers by their paths in ``summary.json``.
        directory: its table, report and runs.
    """

    def __init__(self, rows: Sequence[Row], directory: Path) -> None:
        """Use `sweep`."""
        self.rows, self.directory = tuple(rows), directory

    def to_pandas(self) -> DataFrame:
        """Rows as a table, with ``attrs["units"]`` by column.

        Raises:
            ImportError: one line, if pandas is not installed.
        """
        quantities = shown_quantities(self.rows)
        table = pandas().DataFrame(
            [
                {**dict(row.axes), "runs": row.runs, "completed": row.completed}
                | {quantity.path: row.numbers[quantity.path] for quantity in quantities}
                for row in self.rows
            ]
        )
        table.attrs["units"] = {quantity.path: quantity.unit for quantity in quantities}
        return table

    def __repr__(self) -> str:
        return f"<sweep of {len(self.rows)} points in {self.directory}>"


def sweep(
    scenario: str | os.PathLike[str],
    vary: Mapping[str, Sequence[Any]] | None = None,
    *,
    seeds: Sequence[int] = (1,),
    settings: Mapping[str, Any] | None = None,
    out: str | os.PathLike[str] | None = None,
    jobs: int | None = None,
    progress: bool | None = None,
) -> Sweep:
    """Run every combination of values with every seed, in parallel processes; finished runs are used again.

    Args:
        scenario: name or TOML file of a scenario; without ``vary`` a study file, as ``offtrack sweep`` takes it.
        vary: lists of values by dotted keys: ``{"surface.friction": [0.8, 0.3]}``.
        seeds: seeds that each point of the grid is run with.
        settings: values by dotted keys for all runs.
        out: directory of the study; None: its own, ``runs/sweep-<scenario>-<n>``.
        jobs: number of parallel runs; None: one per core.
        progress: show a progress bar; None: in a terminal or a notebook.

    Raises:
        TypeError: one line, if an argument is of another type.
        ValueError: one line that names key, value and limit.
    """
    name = os.fspath(scenario)
    if vary is None:
        study = load_study(Path(name))
    else:
        axes = {key: [text_of(key, value) for value in _listed(key, values)] for key, values in vary.items()}
        fixed = tuple((key, text_of(key, value)) for key, value in (settings or {}).items())
        study = Study(scenario=name, fixed=fixed, axes=axes, seeds=tuple(checked_seed(seed) for seed in seeds))
    title = f"sweep-{Path(name).stem}"
    with shown_progress(title, shown=progress) as report:
        options = RunOptions(jobs=jobs or default_jobs(), progress=report)
        made = run_study(title, study, None if out is None else Path(out), options)
    return Sweep(made.rows, made.directory)


def _listed(key: str, values: Sequence[Any]) -> Sequence[Any]:
    if isinstance(values, str) or not isinstance(values, Sequence) or not values:
        raise TypeError(f"vary: {key} must be a list of values, not {values!r}")
    return values
