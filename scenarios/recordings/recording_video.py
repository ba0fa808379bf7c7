"""The video of a recording: the left camera with its features, the way from above, the off-tracking over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from scenarios.progress import Progress, no_progress
from scenarios.recordings.estimation import Estimation
from scenarios.recordings.recording_figures import elapsed, paths
from scenarios.recordings.recording_page import camera_frame
from scenarios.report.canvas import (
    ESTIMATED,
    INK,
    LINE,
    PAPER,
    SOFT,
    TRUE,
    Colour,
    Picture,
    StripChart,
    blank,
    curve,
    nice_step,
    write,
)
from scenarios.report.video import Reel, camera_picture, write_reel
from scenarios.results.log import LOST, Log
from scenarios.results.metrics import peak
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_WIDTH, _PLAN_WIDTH, _HEIGHT, _READINGS = 1280, 620, 430, 150  # [px], as in the video of a run
_MARGIN: Final = 30  # around the way [px]
_HEAD: Final = 34  # for the key above it [px]


def write_video(
    estimation: Estimation, log: Log, path_without_suffix: Path, *, progress: Progress = no_progress
) -> Path:
    """Writes a picture for every frame, in real time, and returns the path; images are read once more for it."""
    composition = Composition.of(estimation, log)
    period = float(np.median(np.diff([frame.files.tick for frame in estimation.frames]))) * TICK
    rate = int(np.clip(round(1.0 / period), 1, 60))
    reel = Reel(picture=composition.picture, count=len(estimation.frames), rate=rate)
    return write_reel(reel, path_without_suffix, progress=progress)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Composition:
    """What is drawn into the picture of every frame."""

    estimation: Estimation
    log: Log
    chart: StripChart
    hitch: FloatArray  # (n, 2) in the plan [px]
    follow: FloatArray  # (n, 2)
    true: FloatArray | None  # (n, 2) hitch by the recording's own poses
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
        room = np.array([_PLAN_WIDTH - 2 * _MARGIN, _HEIGHT - 2 * _MARGIN - _HEAD])
        scale = float(np.min(room / np.maximum(high - low, 1.0)))
        middle = np.array([0.5 * _PLAN_WIDTH, 0.5 * (_HEIGHT + _HEAD)])

        def pixels(points: FloatArray) -> FloatArray:
            placed: FloatArray = middle + scale * np.array([1.0, -1.0]) * (points - 0.5 * (low + high))
            return placed

        largest = float(np.nanmax([0.0, peak(log["off_tracking"]), peak(log["off_tracking_poses"])]))
        size = (_WIDTH - _PLAN_WIDTH - 1, _HEIGHT - _READINGS)
        first = next(frame for frame in estimation.frames if not frame.dropped)
        return cls(
            estimation=estimation,
            log=log,
            chart=StripChart.with_axes(size, float(elapsed(log)[-1]), largest),
            hitch=pixels(hitch),
            follow=pixels(follow),
            true=None if true is None else pixels(true),
            scale=scale,
            camera_height=len(camera_picture(camera_frame(estimation, first))),
        )

    def picture(self, k: int) -> Picture:
        """The picture of frame ``k``."""
        panel = blank(_WIDTH - _PLAN_WIDTH - 1, _HEIGHT)
        self._readings(panel, k)
        known = ((self._known("off_tracking"), ESTIMATED, 4), (self._known("off_tracking_poses"), TRUE, 2))
        now = float(elapsed(self.log)[k])
        panel[_READINGS:] = self.chart.draw(now, tuple((*signal, colour, width) for signal, colour, width in known))
        line = np.full((_HEIGHT, 1, 3), LINE, np.uint8)
        return np.concatenate([self._camera(k), np.concatenate([self._plan(k), line, panel], axis=1)])

    def _camera(self, k: int) -> Picture:
        frame = self.estimation.frames[k]
        try:
            if not frame.dropped:
                return camera_picture(camera_frame(self.estimation, frame))
        except ValueError:  # the image is gone since it was estimated from
            pass
        dark = np.full((self.camera_height, _WIDTH, 3), INK, np.uint8)
        write(dark, "frame dropped", (_WIDTH // 2, self.camera_height // 2 - 12), size=20, colour=PAPER, anchor=0.5)
        return dark

    def _plan(self, k: int) -> Picture:
        plan = blank(_PLAN_WIDTH, _HEIGHT)
        if self.true is not None:
            curve(plan, self.true[: k + 1], (200, 206, 212), 6)
        curve(plan, self.hitch[: k + 1], TRUE, 2)
        curve(plan, self.follow[: k + 1], ESTIMATED, 2)
        curve(plan, np.stack([self.hitch[k], self.follow[k]]), INK, 3)
        keys: list[tuple[str, Colour]] = [("hitch", TRUE), ("follow point", ESTIMATED), ("trailer", INK)]
        if self.true is not None:
            keys.append(("hitch by the recording's poses", (150, 158, 166)))
        for (text, colour), u in zip(keys, (20, 90, 200, 280), strict=False):
            write(plan, text, (u, 12), size=15, colour=colour)
        self._scale_bar(plan)
        return plan

    def _scale_bar(self, plan: Picture) -> None:
        length = nice_step(120.0 / self.scale, 1)
        right = _PLAN_WIDTH - 18.0
        ends = np.array([[right - self.scale * length, _HEIGHT - 14.0], [right, _HEIGHT - 14.0]])
        curve(plan, ends, SOFT, 2)
        write(plan, f"{length:g} m", (int(ends[:, 0].mean()), _HEIGHT - 38), size=14, colour=SOFT, anchor=0.5)

    def _readings(self, panel: Picture, k: int) -> None:
        log = self.log
        write(panel, self.estimation.recording.sequence.directory.resolve().name[:40], (20, 14), size=19)
        write(panel, f"{float(elapsed(log)[k]):.1f} s", (panel.shape[1] - 20, 14), size=19, anchor=1.0)
        readings: list[tuple[str, str, Colour]] = [
            ("speed", _shown(3.6 * log["v_x"][k], "{:.1f} km/h"), INK),
            ("off-tracking", _shown(log["off_tracking"][k], "{:+z.3f} m"), ESTIMATED),
            ("std. dev.", _shown(1e3 * log["off_tracking_std"][k], "{:.0f} mm"), INK),
            ("health", self._health(k), INK),
        ]
        if self.true is not None:
            readings.insert(1, ("by the poses", _shown(log["off_tracking_poses"][k], "{:+z.3f} m"), TRUE))
        for j, (name, value, colour) in enumerate(readings):
            u = 20 + j * (panel.shape[1] - 30) // len(readings)
            write(panel, name, (u, 58), size=14, colour=SOFT)
            write(panel, value, (u, 76), size=22, colour=colour)
        write(panel, "off-tracking [m], + when the hitch's path lies left", (20, 126), size=14, colour=SOFT)

    def _health(self, k: int) -> str:
        if self.log["dropped"][k]:
            return "dropped"
        health = self.log["health"][k]
        return "none" if not np.isfinite(health) or health >= LOST else "degraded" if health > 0.0 else "ok"

    def _known(self, name: str) -> tuple[FloatArray, FloatArray]:
        values = self.log[name]
        there = np.isfinite(values)
        return elapsed(self.log)[there], values[there]


def _shown(value: float, text: str) -> str:
    return text.format(value) if np.isfinite(value) else "none"
