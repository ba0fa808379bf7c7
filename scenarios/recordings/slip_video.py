"""The video of a rover's recording: camera image with the estimated direction, above the slip angle over time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from scenarios.progress import Progress, no_progress
from scenarios.recordings.slip_estimation import SlipEstimation
from scenarios.report import canvas
from scenarios.report.trace_view import draw_trace
from scenarios.report.video import Reel, write_reel

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
