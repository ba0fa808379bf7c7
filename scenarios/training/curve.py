"""The curve of learning: a row for every update, kept as Parquet and drawn as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from scenarios.report.plots import ESTIMATED, GREY, INK, STYLE, TRUE, WIDTH
from vehicle.frames import FloatArray

_TOGETHER = 15  # points that a mean of the curve is of


class Point(NamedTuple):
    """After one update; the numbers of episodes are means over those that ended since the one before."""

    steps: int  # control steps of all environments so far
    wall_s: float  # time so far [s]
    episodes: int  # that ended
    rms_m: float  # their off-tracking, with the noise of exploring [m]; NaN: none ended
    max_m: float
    mishaps: float  # share of them
    reward: float  # of a control step
    exploration: float  # standard deviation of the actions [-]
    divergence: float  # of the policy from the one before (Kullback-Leibler)
    explained_variance: float  # by the value function [-]


def write_curve(curve: Sequence[Point], path: Path) -> None:
    """Writes it whole or not at all."""
    table = pa.table({name: [getattr(point, name) for point in curve] for name in Point._fields})
    unfinished = path.with_name(f".{path.name}.unfinished")
    pq.write_table(table, unfinished)
    unfinished.replace(path)


def read_curve(path: Path) -> list[Point]:
    """What ``write_curve`` has written.

    Raises:
        ValueError: one line, if it is none.
    """
    table = pq.read_table(path)
    if tuple(table.column_names) != Point._fields:
        raise ValueError(f"{path}: has {', '.join(table.column_names)}, must have {', '.join(Point._fields)}")
    return [Point(**row) for row in table.to_pylist()]


def draw_curve(curve: Sequence[Point], levels: Mapping[str, float], path: Path) -> None:
    """Off-tracking over steps as a PNG, with what laws come to in the same episodes as lines."""
    steps = np.array([point.steps for point in curve]) / 1e6
    colours = (ESTIMATED, INK, GREY, "#2a9d8f", "#8e5ea2")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        ax = figure.subplots()
        rms = np.array([point.rms_m for point in curve])
        there = np.isfinite(rms)
        ax.plot(steps[there], rms[there], color=TRUE, linewidth=0.6, alpha=0.4)
        ax.plot(steps[there], _smoothed(rms[there]), color=TRUE, linewidth=2.0, label="policy, while it explores")
        for (law, level), colour in zip(levels.items(), colours, strict=False):
            ax.axhline(level, color=colour, linewidth=1.3, linestyle=(0, (6, 3)), label=law)
        ax.set(yscale="log", xlabel="control steps of 20 ms [millions]", ylabel="off-tracking of an episode, RMS [m]")
        ax.yaxis.set_major_formatter("{x:g}")
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.2)
        unfinished = path.with_name(f".{path.name}.unfinished")
        figure.savefig(unfinished, dpi=110, format="png")
        unfinished.replace(path)


def _smoothed(values: FloatArray) -> FloatArray:
    """Means over the points around each."""
    half = _TOGETHER // 2
    return np.array([values[max(k - half, 0) : k + half + 1].mean() for k in range(len(values))])
