"""Estimates of the slip angle in a rover's recording, image by image, and their result directory."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from estimators.context import Estimator
from estimators.estimates import Health, SlipAngle
from offtrack.exchange.recordings.rover_recording import RoverRecording
from offtrack.reports import canvas
from offtrack.reports.canvas import Reel, write_reel
from offtrack.reports.page import Figure, Items, Page, Player, Section, outcome_verdict, software_section
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.playback import Chart, Curve, Picture, Playback, PlayedRun, Reading, elapsed, health_spans
from offtrack.reports.plots import BAND, ESTIMATED, TRUE, drawn, zero_line
from offtrack.reports.run_video import draw_trace
from offtrack.reports.run_writer import finish_results
from offtrack.reports.sections import number_cards, number_table
from scenarios.progress import Progress, no_progress
from scenarios.results import metrics
from scenarios.results.log import HEALTH, HEALTH_WORDS, LOST, Log, Signal, write_log
from scenarios.results.rover_result import trace_line
from scenarios.results.run_directory import appearing_at_once
from scenarios.results.run_summary import number, versions
from vehicle.clock import TICK

_DROPPED: Final = 3.0
ROW_WORDS: Final = HEALTH_WORDS | {_DROPPED: "dropped"}
_SIGNALS: Final = (
    Signal("time", "s", "time of the image"),
    Signal("slip_angle", "rad", "slip angle of the body, + left"),
    Signal("slip_angle_std", "rad", "its standard deviation"),
    Signal("health", "-", "0 ok, 1 degraded, 2 lost, 3 no usable image"),
    Signal("wheel_slip", "rad", "slip angle of the left rear wheel, + left"),
    Signal("trace_offset", "m", "lateral offset of the trace from the wheel's centre, + left"),
    Signal("confidence", "-", "confidence that the trace is the wheel's own"),
    Signal("slip_angle_lagged", "rad", "slip angle at this time, estimated with later images too"),
    Signal("slip_angle_lagged_std", "rad", "its standard deviation"),
    Signal("slip_angle_reference", "rad", "slip angle in the recording's own slip.csv"),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlipEstimation:
    """Estimates from a recording, up to its end or an interrupt."""

    recording: RoverRecording
    estimator: str
    outcome: str  # "completed" or "interrupted"
    dropped: dict[int, str]  # unusable images and the reasons
    log: Log  # one row per image
    seconds: float  # of the estimator alone


def estimate_slip(
    recording: RoverRecording, name: str, source: Estimator[Any, Any, SlipAngle], progress: Progress = no_progress
) -> SlipEstimation:
    """Estimate the slip angle in every image; an interrupt ends this early and keeps the images so far.

    Raises:
        ValueError: one line, if no image can be used.
    """
    memory, seconds, outcome = source.init(), 0.0, "completed"
    estimates: list[SlipAngle | None] = []
    dropped: dict[int, str] = {}
    try:
        for k in range(len(recording.images)):
            view = recording.view(k)
            if isinstance(view, str):
                dropped[k] = view
                estimates.append(None)
            else:
                start = time.perf_counter()
                memory, estimate = source.step(memory, view)
                seconds += time.perf_counter() - start
                estimates.append(estimate)
            progress(k + 1, len(recording.images), f"image {k + 1} of {len(recording.images)}")
    except KeyboardInterrupt:
        outcome = "interrupted"
    if estimates and all(estimate is None for estimate in estimates):
        raise ValueError(f"{recording.directory}: no image can be used. First reason: {dropped[0]}")
    return SlipEstimation(
        recording=recording,
        estimator=name,
        outcome=outcome,
        dropped=dropped,
        log=_log(recording, estimates),
        seconds=seconds,
    )


def slip_summary(estimation: SlipEstimation) -> dict[str, Any]:
    """Summary of an estimation for JSON."""
    log = estimation.log
    error = np.degrees(log["slip_angle"] - log["slip_angle_reference"])
    lagged = np.degrees(log["slip_angle_lagged"] - log["slip_angle_reference"])
    used = log["health"] < _DROPPED
    return {
        "outcome": estimation.outcome,
        "recording": estimation.recording.directory.resolve().name,
        "estimator": estimation.estimator,
        "frames": {
            "images": len(log),
            "dropped": len(estimation.dropped),
            "duration_s": number(float(log["time"][-1] - log["time"][0])) if len(log) else None,
        },
        "slip": {
            "mean_deg": number(math.degrees(metrics.mean(log["slip_angle"]))),
            "max_deg": number(math.degrees(metrics.peak(log["slip_angle"]))),
            "std_mean_deg": number(math.degrees(metrics.mean(log["slip_angle_std"]))),
            "valid_fraction": number(float(np.mean(log["health"][used] < LOST))) if used.any() else None,
            "error_rms_deg": number(metrics.rms(error)),
            "error_max_deg": number(metrics.peak(error)),
            "lagged_error_rms_deg": number(metrics.rms(lagged)),
            "within_2_5_sigma": number(metrics.within_sigmas(error, np.degrees(log["slip_angle_std"]))),
        },
        "timing": {"estimator_ms_per_image": number(1e3 * estimation.seconds / max(1, int(used.sum())))},
        "dropped_images": [{"image": k, "reason": reason} for k, reason in estimation.dropped.items()],
    }


def _log(recording: RoverRecording, estimates: list[SlipAngle | None]) -> Log:
    times = recording.readings[: len(estimates), 0]
    table = np.full((len(estimates), len(_SIGNALS)), np.nan)
    table[:, 0] = times
    rows = {round(time / TICK): k for k, time in enumerate(times)}
    for k, estimate in enumerate(estimates):
        table[k, 3] = _DROPPED if estimate is None else HEALTH[estimate.health]
        if estimate is None or estimate.health is Health.LOST:
            continue
        table[k, 1:3] = estimate.value, estimate.std
        table[k, 4:7] = estimate.wheel_slip, estimate.trace_offset, estimate.confidence
        if estimate.lagged_tick in rows:
            table[rows[estimate.lagged_tick], 7:9] = estimate.lagged_value, estimate.lagged_std
    if recording.slip is not None and len(recording.slip):
        known = (times >= recording.slip[0, 0]) & (times <= recording.slip[-1, 0])
        table[known, 9] = np.radians(np.interp(times[known], recording.slip[:, 0], recording.slip[:, 1]))
    return Log(_SIGNALS, table)


_MOST_PICTURES = 240  # each is read again
_DEGREES = 180.0 / np.pi


def slip_playback(estimation: SlipEstimation, name: str) -> Playback:
    """Everything that a page shows of the recording over time."""
    log = elapsed(estimation.log)
    slip = (
        Curve("slip_angle_std", "±2 σ", "estimated", "band", _DEGREES, base="slip_angle"),
        Curve("slip_angle", "estimated", "estimated", "dots", _DEGREES),
        Curve("slip_angle_lagged", "estimated later", "third", "dots", _DEGREES),
        Curve("slip_angle_reference", "by the recording", "true", scale=_DEGREES),
    )
    return Playback(
        title=name,
        runs=(
            PlayedRun(
                name=name,
                log=log,
                bodies=(),
                spans=tuple(health_spans(log, "health")),
                pictures=list(_pictures(estimation, log)),
            ),
        ),
        charts=(
            Chart("Slip angle, + left", "°", slip, 2),
            Chart("Offset of the trace, + left", "mm", (Curve("trace_offset", "offset", "true", scale=1e3),), 1),
            Chart("Confidence in the trace", "-", (Curve("confidence", "confidence", "true"),), 2),
        ),
        readings=(
            Reading("slip angle", "slip_angle", "°", _DEGREES, 2, "estimated"),
            Reading("its σ", "slip_angle_std", "°", _DEGREES, 2, "estimated"),
            Reading("by the recording", "slip_angle_reference", "°", _DEGREES, 2, "true"),
            Reading("confidence", "confidence", "-", 1.0, 2),
        ),
    )


def _pictures(estimation: SlipEstimation, log: Log) -> Iterator[Picture]:
    recording = estimation.recording
    for k in range(0, len(log), max(1, -(-len(log) // _MOST_PICTURES))):
        view = recording.view(k)
        if isinstance(view, str):  # the reason why there is no image
            continue
        strokes, lines = np.zeros((0, 4)), tuple[int, ...]()
        slip = float(log["wheel_slip"][k])
        if math.isfinite(slip):
            direction = math.radians(recording.readings[k, 8]) + slip
            line = trace_line(recording.rig, direction, float(log["trace_offset"][k]))
            strokes, lines = np.hstack([line[:-1], line[1:]]), (0, len(line) - 1)  # no true line
        jpeg = cv2.imencode(".jpg", view.image)[1].tobytes()
        yield Picture(float(log["time"][k]), jpeg, strokes.astype(np.float32), f"image {k}", lines)


_LAGGED: Final = "#12935f"
_ON_CARDS: Final = ("slip.error_rms_deg", "slip.mean_deg", "slip.valid_fraction", "timing.estimator_ms_per_image")


def slip_page(estimation: SlipEstimation, numbers: dict[str, Any]) -> str:
    """The page as HTML; ``numbers`` is the summary."""
    name = numbers["recording"]
    playback = Section("Playback", content=[Player(encoded(slip_playback(estimation, name)))])
    sections = [
        *([playback] if len(estimation.log) > 1 else []),
        Section(
            "Slip angle", "Angle from the body's axis to the direction of travel, + left.", [_slip(estimation.log)]
        ),
    ]
    if estimation.dropped:
        dropped = [f"image {k}: {reason}" for k, reason in estimation.dropped.items()]
        sections.append(Section("Images that could not be used", content=[Items(dropped)]))
    sections += [Section("All numbers", content=[number_table(numbers)]), software_section(versions())]
    return Page(
        title=f"{name} · slip angle",
        heading=name,
        subtitle=f"{numbers['frames']['images']} images · estimator {estimation.estimator}",
        verdict=outcome_verdict(estimation.outcome),
        cards=number_cards(numbers, _ON_CARDS),
        sections=sections,
    ).html()


def _slip(log: Log) -> Figure:
    """The estimate with its band, the later estimate and the recording's own slip angle."""
    time, value, band = log["time"], np.degrees(log["slip_angle"]), 2.0 * np.degrees(log["slip_angle_std"])
    known = np.isfinite(value)
    with drawn("slip of a recording", 3.4) as (drawing, ax):
        ax.fill_between(
            time[known], (value - band)[known], (value + band)[known], color=BAND, linewidth=0.0, label="±2 σ stated"
        )
        ax.plot(time[known], value[known], ".", color=ESTIMATED, label="estimated")
        for name, colour, label in (
            ("slip_angle_lagged", _LAGGED, "estimated later"),
            ("slip_angle_reference", TRUE, "by the recording"),
        ):
            there = np.isfinite(log[name])
            if there.any():
                ax.plot(time[there], np.degrees(log[name][there]), color=colour, label=label)
        zero_line(ax)
        ax.set(xlabel="time [s]", ylabel="slip angle [°], + left")
        ax.margins(x=0.0)
    return drawing.content


_CHART_HEIGHT: Final = 220  # [px] below the camera's image
_HEAD: Final = 56  # [px] of the numbers above the chart
_RATE: Final = 10  # pictures a second


def write_video(estimation: SlipEstimation, path_without_suffix: Path, *, progress: Progress = no_progress) -> Path:
    """Writes a video with a picture for every image and returns its path."""
    reel = Reel(picture=Film.of(estimation).picture, count=len(estimation.log), rate=_RATE)
    return write_reel(reel, path_without_suffix, progress=progress)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Film:
    """Everything that does not change from one picture to the next."""

    estimation: SlipEstimation
    chart: canvas.StripChart

    @classmethod
    def of(cls, estimation: SlipEstimation) -> Film:
        """The film of these estimates."""
        log = estimation.log
        curves = np.degrees(np.concatenate([log["slip_angle"], log["slip_angle_reference"]]))
        size = (estimation.recording.rig.camera.width, _CHART_HEIGHT - _HEAD)
        duration = float(log["time"][-1] - log["time"][0])
        largest = float(np.nanmax(np.abs(curves), initial=2.0))
        return cls(estimation=estimation, chart=canvas.StripChart.with_axes(size, duration, largest))

    def picture(self, k: int) -> canvas.Picture:
        """The picture of image ``k``, RGB."""
        log = self.estimation.log
        shown = self._camera(k)
        lower = canvas.blank(shown.shape[1], _CHART_HEIGHT)
        canvas.write_readings(lower, self._readings(k), 4, left=16, size=22)
        time = log["time"] - log["time"][0]
        curves = [
            (*canvas.known_part(time, np.degrees(log[name])), colour, width)
            for name, colour, width in (("slip_angle", canvas.ESTIMATED, 3), ("slip_angle_reference", canvas.TRUE, 2))
        ]
        lower[_HEAD:] = self.chart.draw(float(time[k]), curves)
        picture = np.concatenate([shown, lower])
        return np.pad(picture, ((0, len(picture) % 2), (0, picture.shape[1] % 2), (0, 0)))  # H.264 wants even sizes

    def _camera(self, k: int) -> canvas.Picture:
        recording, log = self.estimation.recording, self.estimation.log
        view = recording.view(k)
        if isinstance(view, str):
            return np.full((recording.rig.camera.height, recording.rig.camera.width, 3), 90, np.uint8)
        shown = np.asarray(cv2.cvtColor(view.image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
        pointed, slip = math.radians(recording.readings[k, 8]), float(log["wheel_slip"][k])
        if math.isfinite(slip):
            draw_trace(shown, recording.rig, pointed + slip, float(log["trace_offset"][k]), canvas.ESTIMATED)
        return shown

    def _readings(self, k: int) -> tuple[canvas.Reading, ...]:
        log = self.estimation.log
        return (
            ("time", f"{float(log['time'][k]):.1f} s", canvas.INK),
            ("slip angle", _degrees(float(log["slip_angle"][k])), canvas.ESTIMATED),
            ("by the recording", _degrees(float(log["slip_angle_reference"][k])), canvas.TRUE),
        )


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):+.1f}°" if math.isfinite(angle) else "none"


def write_slip_estimation(
    estimation: SlipEstimation, directory: Path, *, video: bool, progress: Progress = no_progress
) -> dict[str, Any]:
    """Writes everything and returns the summary; ``progress`` counts the frames of the video.

    Raises:
        ValueError: if the directory can not take it.
    """
    numbers = slip_summary(estimation)
    with appearing_at_once(directory) as folder:
        (folder / "slip.csv").write_text(csv_text(estimation.log), encoding="utf-8")
        write_log(estimation.log, folder / "slip.parquet")
        (folder / "report.html").write_text(slip_page(estimation, numbers), encoding="utf-8")
        drawn = video and len(estimation.log) > 1
        finish_results(
            folder, numbers, (lambda path: write_video(estimation, path, progress=progress)) if drawn else None
        )
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
