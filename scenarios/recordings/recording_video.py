"""The video of a recording: left camera with its features, plan view, and off-tracking over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from scenarios.progress import Progress, no_progress
from scenarios.recordings.estimation import Estimation
from scenarios.recordings.left_images import camera_frame
from scenarios.recordings.recording_figures import elapsed, paths
from scenarios.report import canvas
from scenarios.report.flow import camera_picture
from scenarios.report.run_video import PLAN_WIDTH, READINGS, ROW_HEIGHT, off_tracking_panel, side_by_side
from scenarios.report.video import Reel, write_reel
from scenarios.results.log import LOST, Log
from scenarios.results.metrics import peak
from vehicle.clock import TICK
from vehicle.frames import FloatArray

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
