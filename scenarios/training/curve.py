"""The learning curve: a row for every update, stored as Parquet and drawn as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from scenarios.report.plots import ESTIMATED, GREY, INK, SERIES, STYLE, TRUE, WIDTH, legend_below
from scenarios.results.files import replacing
from scenarios.results.parquet_file import read_table
from vehicle.frames import FloatArray

_WINDOW = 15  # points of the moving average
_LEVELS = (ESTIMATED, INK, GREY, *SERIES[2:4])  # colours of the laws


class Point(NamedTuple):
    """State of the training after one update; episode numbers are means over the episodes since the last update."""

    steps: int  # control steps of all environments so far
    wall_s: float  # computing time so far [s]
    episodes: int  # ended since the last update
    rms_m: float  # off-tracking, with exploration noise [m]; NaN: no episode ended
    max_m: float  # the same, maximum [m]
    mishaps: float  # share of the episodes that ended badly
    reward: float  # mean of a control step
    exploration: float  # standard deviation of the actions [-]
    divergence: float  # of the policy from the previous one (Kullback-Leibler)
    explained_variance: float  # by the value function [-]


def write_curve(curve: Sequence[Point], path: Path) -> None:
    """Writes the curve; the file appears complete or not at all."""
    table = pa.table({name: [getattr(point, name) for point in curve] for name in Point._fields})
    with replacing(path) as unfinished:
        pq.write_table(table, unfinished)


def read_curve(path: Path) -> list[Point]:
    """The curve in a file of :func:`write_curve`.

    Raises:
        ValueError: one line, if the file cannot be read or has other columns.
    """
    table = read_table(path)
    if tuple(table.column_names) != Point._fields:
        raise ValueError(f"{path}: has {', '.join(table.column_names)}, must have {', '.join(Point._fields)}")
    return [Point(**row) for row in table.to_pylist()]


def draw_curve(curve: Sequence[Point], levels: Mapping[str, float], path: Path) -> None:
    """Draws off-tracking over steps as a PNG, with the off-tracking of trailer laws in the same episodes as lines."""
    steps = np.array([point.steps for point in curve]) / 1e6
    rms = np.array([point.rms_m for point in curve])
    known = np.isfinite(rms)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        ax = figure.subplots()
        ax.plot(steps[known], rms[known], color=TRUE, linewidth=0.6, alpha=0.4)
        ax.plot(steps[known], _smoothed(rms[known]), color=TRUE, linewidth=2.0, label="policy while exploring")
        for (law, level), colour in zip(levels.items(), _LEVELS, strict=False):
            ax.axhline(level, color=colour, linewidth=1.3, linestyle=(0, (6, 3)), label=law)
        ax.set(yscale="log", xlabel="control steps of 20 ms [millions]", ylabel="off-tracking of an episode, RMS [m]")
        ax.yaxis.set_major_formatter("{x:g}")
        legend_below(figure, ax)
        with replacing(path) as unfinished:
            figure.savefig(unfinished, dpi=110, format="png")


def _smoothed(values: FloatArray) -> FloatArray:
    """Moving average."""
    half = _WINDOW // 2
    return np.array([values[max(k - half, 0) : k + half + 1].mean() for k in range(len(values))])
