"""Figures and the video of a stereo recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from matplotlib.axes import Axes

from offtrack.exchange.recordings.estimation import Estimation, FrameEstimate, error_of_estimate
from offtrack.reports import canvas, plots
from offtrack.reports.canvas import Reel, write_reel
from offtrack.reports.page import Figure
from offtrack.reports.run_video import (
    PLAN_WIDTH,
    READINGS,
    ROW_HEIGHT,
    camera_picture,
    off_tracking_panel,
    side_by_side,
)
from scenarios.image_file import read_grey
from scenarios.progress import Progress, no_progress
from scenarios.results.log import LOST, Log
from scenarios.results.metrics import peak
from scenarios.results.trailer_result import CameraFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_DEGRADED, _DROPPED = "#fbf3d0", "#d9dde2"
_TIME: Final = "time since the first frame [s]"


def plan_view(estimation: Estimation) -> Figure:
    """Paths of hitch and follow point from above, and the hitch's path by the recording's own poses."""
    hitch, follow = paths(estimation, estimation.X_S0S)
    true = estimation.true_X_S0S
    with plots.plan_drawn("plan", [hitch, follow] + ([] if true is None else [true[:, :2, 3]])) as (drawing, ax):
        if true is not None:
            ax.plot(
                *true[:, :2, 3].T,
                color=plots.GREY,
                linewidth=4.5,
                alpha=0.55,
                label="path of the hitch, recorded poses",
            )
        ax.plot(*hitch.T, color=plots.TRUE, label="path of the hitch, odometry")
        ax.plot(*follow.T, color=plots.ESTIMATED, linewidth=1.2, label="path of the follow point, odometry")
        ax.plot(*hitch[0], "o", color=plots.TRUE, markersize=5.0)
    return drawing.content


def paths(estimation: Estimation, X_S0S: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Paths (n, 2) of hitch and follow point along the axes of the first trailer frame."""
    follow = X_S0S[:, :2, 3] - estimation.recording.follow_distance * X_S0S[:, :2, 0]
    return X_S0S[:, :2, 3], follow


def off_tracking(log: Log) -> Figure:
    """Off-tracking over time with twice its standard deviation, and that of the recording's own poses."""
    with plots.drawn("off_tracking", 3.0) as (drawing, ax):
        time = elapsed(log)
        value, band = log["off_tracking"], 2.0 * log["off_tracking_std"]
        _shade(ax, log)
        ax.fill_between(time, value - band, value + band, color=plots.BAND, linewidth=0.0, label="±2 σ stated")
        if np.isfinite(log["off_tracking_poses"]).any():
            ax.plot(time, log["off_tracking_poses"], color=plots.TRUE, label="recorded poses", zorder=4)
        ax.plot(time, value, ".-", color=plots.ESTIMATED, linewidth=0.9, markersize=4.0, label="estimated")
        plots.over_time(ax, time, "off-tracking [m], + left", xlabel=_TIME)
    return drawing.content


def error(log: Log) -> Figure:
    """Error of the estimate against the recording's own poses, inside the band it states."""
    with plots.drawn("error", 2.7) as (drawing, ax):
        _shade(ax, log)
        plots.error_band(ax, elapsed(log), 1e3 * error_of_estimate(log), 1e3 * log["off_tracking_std"])
        plots.over_time(ax, elapsed(log), "error [mm]", xlabel=_TIME)
    return drawing.content


def features(log: Log) -> Figure:
    """Matches and inliers frame by frame, with the health of the odometry behind them."""
    with plots.drawn("features", 2.5) as (drawing, ax):
        _shade(ax, log)
        for name, colour in (("matches", plots.GREY), ("inliers", plots.TRUE)):
            ax.plot(elapsed(log), log[name], color=colour, label=name)
        ax.set_ylim(bottom=0.0)
        plots.over_time(ax, elapsed(log), "features per frame [-]", xlabel=_TIME, zero=False)
    return drawing.content


def right_rotation(log: Log) -> Figure:
    """Estimated rotation of the right camera, with twice its standard deviation."""
    with plots.drawn("rotation", 2.7) as (drawing, ax):
        time = elapsed(log)
        for name, colour in zip(("roll", "yaw", "pitch"), plots.SERIES, strict=False):
            angle, band = (np.degrees(log[f"right_{name}{end}"]) for end in ("", "_std"))
            ax.fill_between(time, angle - 2.0 * band, angle + 2.0 * band, color=colour, alpha=0.15, linewidth=0.0)
            ax.plot(time, angle, color=colour, label=name)
        plots.over_time(ax, time, "angle [°]", xlabel=_TIME)
    return drawing.content


def elapsed(log: Log) -> FloatArray:
    """Time since the first frame [s]."""
    since: FloatArray = log["time"] - log["time"][0]
    return since


def _shade(ax: Axes, log: Log) -> None:
    """Shades the time before each frame that was dropped or whose motion was degraded or lost."""
    time, health = elapsed(log), log["odometry_health"]
    edges = np.concatenate([time[:1], time])
    plots.shade(ax, edges, health == 1.0, _DEGRADED, "odometry degraded")
    plots.shade(ax, edges, health >= LOST, plots.LOST_BAND, "odometry lost")
    plots.shade(ax, edges, log["dropped"] > 0.0, _DROPPED, "frame dropped")


def camera_frame(estimation: Estimation, frame: FrameEstimate) -> CameraFrame:
    """The left image, read again and rectified, with its tracks.

    Raises:
        ValueError: if the image can no longer be read.
    """
    image = estimation.recording.rectified_left(read_grey(frame.files.left))
    motion = frame.motion
    return CameraFrame(
        tick=frame.files.tick,
        jpeg=cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes(),
        tracks=frame.tracks,
        matches=motion.matches if motion else 0,
        inliers=motion.inliers if motion else 0,
    )


_MARGIN: Final = 30  # around the path [px]
_HEAD: Final = 34  # for the key above it [px]


def write_video(
    estimation: Estimation, log: Log, path_without_suffix: Path, *, progress: Progress = no_progress
) -> Path:
    """Writes a video in real time with a picture for every frame, whose images are read again, and returns its path."""
    composition = Composition.of(estimation, log)
    period = float(np.median(np.diff([frame.files.tick for frame in estimation.frames]))) * TICK
    rate = int(np.clip(round(1.0 / period), 1, 60))
    reel = Reel(picture=composition.picture, count=len(estimation.frames), rate=rate)
    return write_reel(reel, path_without_suffix, progress=progress)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Composition:
    """Everything drawn into the pictures of the frames."""

    estimation: Estimation
    log: Log
    chart: canvas.StripChart
    hitch: FloatArray  # (n, 2) in the plan [px]
    follow: FloatArray  # (n, 2)
    true: FloatArray | None  # (n, 2) hitch by the recorded poses
    scale: float  # of the plan [px/m]
    camera_height: int  # [px]

    @classmethod
    def of(cls, estimation: Estimation, log: Log) -> Composition:
        """The composition for these estimates."""
        hitch, follow = paths(estimation, estimation.X_S0S)
        true_poses = estimation.true_X_S0S
        true = None if true_poses is None else true_poses[:, :2, 3]
        lines = np.concatenate([hitch, follow] if true is None else [hitch, follow, true])
        low, high = lines.min(axis=0), lines.max(axis=0)
        room = np.array([PLAN_WIDTH - 2 * _MARGIN, ROW_HEIGHT - 2 * _MARGIN - _HEAD])
        scale = float(np.min(room / np.maximum(high - low, 1.0)))
        middle = np.array([0.5 * PLAN_WIDTH, 0.5 * (ROW_HEIGHT + _HEAD)])

        def pixels(points: FloatArray) -> FloatArray:
            placed: FloatArray = middle + scale * np.array([1.0, -1.0]) * (points - 0.5 * (low + high))
            return placed

        largest = float(np.nanmax([0.0, peak(log["off_tracking"]), peak(log["off_tracking_poses"])]))
        size = (canvas.WIDTH - PLAN_WIDTH - 1, ROW_HEIGHT - READINGS)
        first = next(frame for frame in estimation.frames if not frame.dropped)
        return cls(
            estimation=estimation,
            log=log,
            chart=canvas.StripChart.with_axes(size, float(elapsed(log)[-1]), largest),
            hitch=pixels(hitch),
            follow=pixels(follow),
            true=None if true is None else pixels(true),
            scale=scale,
            camera_height=len(camera_picture(camera_frame(estimation, first))),
        )

    def picture(self, k: int) -> canvas.Picture:
        """The picture of frame ``k``."""
        now = float(elapsed(self.log)[k])
        name = self.estimation.recording.sequence.directory.resolve().name[:40]
        curves = tuple(
            (*canvas.known_part(elapsed(self.log), self.log[signal]), colour, thickness)
            for signal, colour, thickness in (
                ("off_tracking", canvas.ESTIMATED, 4),
                ("off_tracking_poses", canvas.TRUE, 2),
            )
        )
        panel = off_tracking_panel(name, now, self._readings(k), self.chart, curves)
        return np.concatenate([self._camera(k), side_by_side(self._plan(k), panel)])

    def _camera(self, k: int) -> canvas.Picture:
        frame = self.estimation.frames[k]
        try:
            if not frame.dropped:
                return camera_picture(camera_frame(self.estimation, frame))
        except ValueError:  # the image has disappeared since
            pass
        dark = np.full((self.camera_height, canvas.WIDTH, 3), canvas.INK, np.uint8)
        canvas.write(
            dark,
            "frame dropped",
            (canvas.WIDTH // 2, self.camera_height // 2 - 12),
            size=20,
            colour=canvas.PAPER,
            anchor=0.5,
        )
        return dark

    def _plan(self, k: int) -> canvas.Picture:
        plan = canvas.blank(PLAN_WIDTH, ROW_HEIGHT)
        if self.true is not None:
            canvas.curve(plan, self.true[: k + 1], (200, 206, 212), 6)
        canvas.curve(plan, self.hitch[: k + 1], canvas.TRUE, 2)
        canvas.curve(plan, self.follow[: k + 1], canvas.ESTIMATED, 2)
        canvas.curve(plan, np.stack([self.hitch[k], self.follow[k]]), canvas.INK, 3)
        keys = [("hitch", canvas.TRUE), ("follow point", canvas.ESTIMATED), ("trailer", canvas.INK)]
        if self.true is not None:
            keys.append(("hitch, recorded poses", (150, 158, 166)))
        for (text, colour), u in zip(keys, (20, 90, 200, 280), strict=False):
            canvas.write(plan, text, (u, 12), size=15, colour=colour)
        canvas.scale_bar(plan, self.scale, canvas.nice_step(120.0 / self.scale, 1))
        return plan

    def _readings(self, k: int) -> list[canvas.Reading]:
        log = self.log
        readings: list[canvas.Reading] = [
            ("speed", _text(3.6 * log["v_x"][k], "{:.1f} km/h"), canvas.INK),
            ("off-tracking", _text(log["off_tracking"][k], "{:+z.3f} m"), canvas.ESTIMATED),
            ("std. dev.", _text(1e3 * log["off_tracking_std"][k], "{:.0f} mm"), canvas.INK),
            ("health", self._health(k), canvas.INK),
        ]
        if self.true is not None:
            readings.insert(1, ("recorded poses", _text(log["off_tracking_poses"][k], "{:+z.3f} m"), canvas.TRUE))
        return readings

    def _health(self, k: int) -> str:
        if self.log["dropped"][k]:
            return "dropped"
        health = self.log["health"][k]
        return "none" if not np.isfinite(health) or health >= LOST else "degraded" if health > 0.0 else "ok"


def _text(value: float, text: str) -> str:
    return text.format(value) if np.isfinite(value) else "none"
