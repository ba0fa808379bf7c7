"""What the slip angles of a recording leave behind: table, summary, report and video in one directory."""

from __future__ import annotations

import csv
import io
import json
import math
from html import escape
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from scenarios.progress import Progress, no_progress
from scenarios.recordings.slip_estimation import ROW_WORDS, SlipEstimation, slip_summary
from scenarios.report.canvas import ESTIMATED, INK, SOFT, TRUE, Colour, Picture, StripChart, blank, write
from scenarios.report.drawing import ESTIMATED as ESTIMATED_LINE
from scenarios.report.drawing import GREY, drawn
from scenarios.report.drawing import TRUE as TRUE_LINE
from scenarios.report.page import html_page, section_html
from scenarios.report.trace_view import draw_trace
from scenarios.report.video import Reel, write_reel
from scenarios.results.log import Log, write_log
from scenarios.results.run import appearing_at_once, versions

_CHART_HEIGHT: Final = 220  # [px] below the camera's image
_HEAD: Final = 56  # [px] of the numbers above the chart
_RATE: Final = 10  # pictures a second


def write_slip_estimation(
    estimation: SlipEstimation, directory: Path, *, video: bool, progress: Progress = no_progress
) -> dict[str, Any]:
    """Writes everything and returns the summary; ``progress`` is told the frames of the video.

    Raises:
        ValueError: if the directory can not take it.
    """
    numbers = slip_summary(estimation)
    with appearing_at_once(directory) as folder:
        (folder / "slip.csv").write_text(csv_text(estimation.log), encoding="utf-8")
        write_log(estimation.log, folder / "slip.parquet")
        (folder / "report.html").write_text(report_page(estimation, numbers), encoding="utf-8")
        if video and len(estimation.log) > 1:
            film = Film(estimation)
            reel = Reel(picture=film.picture, count=len(estimation.log), rate=_RATE)
            write_reel(reel, folder / "video", progress=progress)
        (folder / "summary.json").write_text(json.dumps(numbers, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return numbers


def csv_text(log: Log) -> str:
    """The table as CSV: angles in degrees, empty where there is no value, health in words."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    ends = {"rad": "_deg", "m": "_m", "s": "_s", "-": ""}
    writer.writerow([signal.name + ends[signal.unit] for signal in log.signals])
    for row in range(len(log)):
        cells = []
        for signal in log.signals:
            value = float(log[signal.name][row])
            if signal.name == "health":
                cells.append(ROW_WORDS[value])
            elif not math.isfinite(value):
                cells.append("")
            else:
                cells.append(f"{math.degrees(value) if signal.unit == 'rad' else value:.6g}")
        writer.writerow(cells)
    return file.getvalue()


def report_page(estimation: SlipEstimation, numbers: dict[str, Any]) -> str:
    """One HTML page that needs nothing but itself."""
    name = escape(numbers["recording"])
    good = " completed" if estimation.outcome == "completed" else ""
    parts = [
        f'<header>\n<h1>{name}<span class="outcome{good}">{escape(estimation.outcome)}</span></h1>\n'
        f"<p>{numbers['frames']['images']} images · estimator {escape(estimation.estimator)}</p>\n</header>",
        section_html("Slip angle", "Of the body, between its way and its axis, + left.", slip_svg(estimation.log)),
        section_html("All numbers", "", _table(numbers)),
    ]
    if estimation.dropped:
        lines = "".join(f"<li>image {k}: {escape(reason)}</li>" for k, reason in estimation.dropped.items())
        parts.append(section_html("Images that could not be used", "", f"<ul>{lines}</ul>"))
    parts.append(section_html("Made with", ", ".join(f"{key} {value}" for key, value in versions().items())))
    return html_page(f"{name} · slip angle · offtrack", "\n".join(parts))


def slip_svg(log: Log) -> str:
    """SVG: the estimate with its band, and what it can be compared with."""
    time, there = log["time"], np.isfinite(log["slip_angle"])
    value, band = np.degrees(log["slip_angle"][there]), 2.0 * np.degrees(log["slip_angle_std"][there])
    with drawn("slip of a recording", 3.4) as (drawing, ax):
        ax.axhline(0.0, color=GREY, linewidth=0.8)
        ax.fill_between(time[there], value - band, value + band, color="#f9e3cf", linewidth=0.0, label="±2 σ")
        ax.plot(time[there], value, ".", color=ESTIMATED_LINE, label="estimated")
        later, known = np.isfinite(log["slip_angle_lagged"]), np.isfinite(log["slip_angle_reference"])
        if later.any():
            ax.plot(time[later], np.degrees(log["slip_angle_lagged"][later]), color="#12935f", label="known later")
        if known.any():
            reference = np.degrees(log["slip_angle_reference"][known])
            ax.plot(time[known], reference, color=TRUE_LINE, label="by the recording")
        ax.set(xlabel="time [s]", ylabel="slip angle [°], + left")
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5)
    return drawing.svg


def _table(numbers: dict[str, Any]) -> str:
    rows = [
        f'<tr><th>{escape(f"{group}: {name}")}</th><td class="value">{value:.4g}</td></tr>'
        for group in ("frames", "slip", "timing")
        for name, value in numbers[group].items()
        if value is not None
    ]
    return f'<div class="scroll"><table>{"".join(rows)}</table></div>'


class Film:
    """Pictures of the recording with the estimated direction, above the slip angle over time."""

    def __init__(self, estimation: SlipEstimation) -> None:
        self._estimation, log = estimation, estimation.log
        curves = np.degrees(np.concatenate([log["slip_angle"], log["slip_angle_reference"]]))
        largest = float(np.nanmax(np.abs(curves), initial=2.0))
        self._size = (estimation.recording.rig.camera.height, estimation.recording.rig.camera.width)
        duration = float(log["time"][-1] - log["time"][0])
        self._chart = StripChart.with_axes((self._size[1], _CHART_HEIGHT - _HEAD), duration, largest)

    def picture(self, k: int) -> Picture:
        """The picture of view k, RGB."""
        log, recording = self._estimation.log, self._estimation.recording
        view = recording.view(k)
        shown = np.full((*self._size, 3), 90, np.uint8)
        if not isinstance(view, str):
            shown = np.asarray(cv2.cvtColor(view.image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
            pointed, slip = math.radians(recording.readings[k, 8]), float(log["wheel_slip"][k])
            if math.isfinite(slip):
                draw_trace(shown, recording.rig, pointed + slip, float(log["trace_offset"][k]), ESTIMATED)
        lower = blank(self._size[1], _CHART_HEIGHT)
        self._readings(lower, k)
        time = log["time"] - log["time"][0]
        curves = []
        for name, colour, width in (("slip_angle", ESTIMATED, 3), ("slip_angle_reference", TRUE, 2)):
            there = np.isfinite(log[name])
            curves.append((time[there], np.degrees(log[name][there]), colour, width))
        lower[_HEAD:] = self._chart.draw(float(time[k]), tuple(curves))
        height, width = (2 * ((side + 1) // 2) for side in (self._size[0] + _CHART_HEIGHT, self._size[1]))
        return np.pad(
            np.concatenate([shown, lower]), ((0, height - len(shown) - len(lower)), (0, width - self._size[1]), (0, 0))
        )

    def _readings(self, panel: Picture, k: int) -> None:
        log = self._estimation.log
        readings: tuple[tuple[str, str, Colour], ...] = (
            ("time", f"{float(log['time'][k]):.1f} s", INK),
            ("slip angle", _degrees(float(log["slip_angle"][k])), ESTIMATED),
            ("by the recording", _degrees(float(log["slip_angle_reference"][k])), TRUE),
        )
        for number, (name, value, colour) in enumerate(readings):
            u = 16 + number * panel.shape[1] // len(readings)
            write(panel, name, (u, 4), size=14, colour=SOFT)
            write(panel, value, (u, 22), size=22, colour=colour)


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):+.1f}°" if math.isfinite(angle) else "none"
