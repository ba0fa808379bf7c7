"""The video of a run: what the camera saw with its features, the run from above, and the off-tracking over time."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from scenarios.report.canvas import ESTIMATED, INK, LINE, PAPER, SOFT, TRUE, Colour, Picture, StripChart, blank, write
from scenarios.report.plan_view import PlanView
from scenarios.results.log import LOST
from scenarios.results.metrics import peak
from scenarios.results.run import CameraFrame, Progress, RunResult
from vehicle.frames import FloatArray

_FRAME_RATE = 10  # [1/s] that of the cameras
_PERIOD = 100  # [ticks] between pictures: real time
_WIDTH = 1280  # [px]
_TALLEST_CAMERA = 480  # [px]
_PLAN_WIDTH, _ROW_HEIGHT, _BLIND_HEIGHT = 620, 430, 640  # [px] of the panels below the camera, and without one
_READINGS = 150  # [px] height of the numbers above the chart
_GIF_WIDTH, _GIF_FRAMES, _GIF_COLOURS = 640, 150, 64  # a GIF of a minute then stays at some megabytes
_FLOW = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]


def write_video(result: RunResult, path_without_suffix: Path, *, progress: Progress | None = None) -> Path:
    """Writes the video and returns its path: H.264 where PyAV is installed, else a smaller and coarser GIF."""
    ticks = range(0, round(float(result.log["tick"][-1])) + 1, _PERIOD)
    composition = _Composition.of_run(result)
    reel = Reel(picture=lambda k: composition.picture(ticks[k]), count=len(ticks), rate=_FRAME_RATE)
    return write_reel(reel, path_without_suffix, progress=progress)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reel:
    """Pictures of one size, drawn when they are asked for by their number."""

    picture: Callable[[int], Picture]
    count: int
    rate: int  # [1/s]


def write_reel(reel: Reel, path_without_suffix: Path, *, progress: Progress | None = None) -> Path:
    """Writes a video of the pictures and returns its path: H.264 where PyAV is installed, else a GIF."""
    encode = _write_h264 if importlib.util.find_spec("av") else _write_gif
    return encode(reel, path_without_suffix, progress or (lambda done, of: None))


def still(result: RunResult, tick: int) -> Picture:
    """One picture of the video, RGB."""
    return _Composition.of_run(result).picture(tick)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Composition:
    """Everything about the pictures of one run that does not change from one to the next."""

    result: RunResult
    plan: PlanView
    chart: StripChart
    true: tuple[FloatArray, FloatArray]  # time, value where there is one
    estimated: tuple[FloatArray, FloatArray]
    frame_ticks: FloatArray

    @classmethod
    def of_run(cls, result: RunResult) -> _Composition:
        height = _ROW_HEIGHT if result.frames else _BLIND_HEIGHT
        true, health = result.signal("off_tracking_true"), result.signal("health")
        estimate = np.where(health < LOST, result.signal("off_tracking_estimate"), np.nan)
        largest = float(np.nanmax([0.0, peak(true), peak(estimate)]))
        return cls(
            result=result,
            plan=PlanView.of_course(
                (_PLAN_WIDTH, height),
                units=result.units,
                poses=tuple(result.poses(unit) for unit in result.units),
                steer=tuple(result.axle_steer(unit) for unit in result.units),
                follow_distance=result.follow_distance,
                road=result.road,
                road_half_width=result.road_half_width,
            ),
            chart=StripChart.with_axes(
                (_WIDTH - _PLAN_WIDTH - 1, height - _READINGS), float(result.log["time"][-1]), largest
            ),
            true=_there(result.log["time"], true, every=5),
            estimated=_there(result.log["time"], estimate, every=1),
            frame_ticks=np.array([frame.tick for frame in result.frames]),
        )

    def picture(self, tick: int) -> Picture:
        """The picture at a tick; the camera shows the newest frame by then."""
        row = max(0, int(np.searchsorted(self.result.log["tick"], tick, side="right")) - 1)
        panel = blank(_WIDTH - _PLAN_WIDTH - 1, self.chart.background.shape[0] + _READINGS)
        self._readings(panel, row)
        now = float(self.result.log["time"][row])
        panel[_READINGS:] = self.chart.draw(now, ((*self.estimated, ESTIMATED, 4), (*self.true, TRUE, 2)))
        plan = self.plan.draw(row)
        line = np.full((len(plan), 1, 3), LINE, np.uint8)
        lower = np.concatenate([plan, line, panel], axis=1)
        if not self.result.frames:
            return lower
        frame = self.result.frames[max(0, int(np.searchsorted(self.frame_ticks, tick, side="right")) - 1)]
        return np.concatenate([camera_picture(frame), lower])

    def _readings(self, panel: Picture, row: int) -> None:
        log, now = self.result.log, float(self.result.log["time"][row])
        write(panel, self.result.scenario, (20, 14), size=19)
        write(panel, f"{now:.1f} s", (panel.shape[1] - 20, 14), size=19, anchor=1.0)
        speed = f"{3.6 * self.result.signal('v_x_' + self.result.units[0].name)[row]:.1f} km/h"
        steer = [math.degrees(log[name][row]) for name in self.result.steer_signals()]
        steering = f"{steer[-1]:+z.1f}°" if steer else "none"
        readings: tuple[tuple[str, str, Colour], ...] = (
            ("speed", speed, INK),
            ("rear axle steer", steering, INK),
            ("true off-tracking", _newest(self.true, now), TRUE),
            ("estimated", _newest(self.estimated, now), ESTIMATED),
        )
        for k, (name, value, colour) in enumerate(readings):
            u = 20 + k * (panel.shape[1] - 30) // len(readings)
            write(panel, name, (u, 58), size=14, colour=SOFT)
            write(panel, value, (u, 76), size=24, colour=colour)
        write(panel, "off-tracking [m], + when the hitch's path lies left", (20, 126), size=14, colour=SOFT)


def _there(time: FloatArray, values: FloatArray, every: int) -> tuple[FloatArray, FloatArray]:
    """Time and value of the rows that have one; of these, every so many-th."""
    rows = np.flatnonzero(np.isfinite(values))[::every]
    return time[rows], values[rows]


def _newest(signal: tuple[FloatArray, FloatArray], now: float) -> str:
    known = signal[1][signal[0] <= now]
    return f"{known[-1]:+z.3f} m" if known.size else "none"


def camera_picture(frame: CameraFrame) -> Picture:
    """The camera's image across the width of the video, with the way each feature took since the frame before."""
    image = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError(f"camera frame of tick {frame.tick} is no JPEG image")
    scale = min(_WIDTH / image.shape[1], _TALLEST_CAMERA / image.shape[0])
    size = (2 * round(0.5 * scale * image.shape[1]), 2 * round(0.5 * scale * image.shape[0]))  # H.264 wants even sizes
    resized = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
    shown = np.asarray(cv2.cvtColor(resized, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    tracks: FloatArray = scale * (frame.tracks.astype(np.float64) + 0.5) - 0.5
    draw_flow(shown, tracks)
    picture = np.full((size[1], _WIDTH, 3), INK, np.uint8)
    left = (_WIDTH - size[0]) // 2
    picture[:, left : left + size[0]] = shown
    strip = picture[:32]
    strip[:] = strip // 5 * 2
    write(
        picture,
        "left camera" + (" and the flow of its features" if len(frame.tracks) else ""),
        (16, 6),
        size=16,
        colour=PAPER,
    )
    if frame.matches:
        counts = f"{frame.inliers} inliers of {frame.matches} matches"
        write(picture, counts, (_WIDTH - 16, 6), size=16, colour=PAPER, anchor=1.0)
    return picture


def draw_flow(picture: Picture, tracks: FloatArray) -> None:
    """Strokes from the previous to the current place of every feature (m, 4), coloured by their length."""
    if not len(tracks):
        return
    length = np.hypot(*(tracks[:, 2:] - tracks[:, :2]).T)
    shade = 40.0 + 190.0 * np.clip(length / max(float(np.percentile(length, 95)), 1e-9), 0.0, 1.0)
    ends = np.rint(16.0 * tracks).astype(np.int32)
    for (u0, v0, u1, v1), k in zip(ends.tolist(), shade.astype(int).tolist(), strict=True):
        colour = _FLOW[k].tolist()
        cv2.line(picture, (u0, v0), (u1, v1), colour, 1, cv2.LINE_AA, 4)
        cv2.circle(picture, (u1, v1), 32, colour, -1, cv2.LINE_AA, 4)


def _pictures(reel: Reel, stride: int, progress: Progress) -> Iterator[Picture]:
    numbers = range(0, reel.count, stride)
    for done, k in enumerate(numbers, start=1):
        yield reel.picture(k)
        progress(done, len(numbers))


def _write_h264(reel: Reel, path_without_suffix: Path, progress: Progress) -> Path:
    import av  # an extra: absent in a lean installation

    path = path_without_suffix.with_name(path_without_suffix.name + ".mp4")
    with av.open(path, "w", options={"movflags": "faststart"}) as container:
        stream = None
        for picture in _pictures(reel, 1, progress):
            if stream is None:
                stream = container.add_stream("h264", rate=reel.rate, options={"crf": "26", "preset": "veryfast"})
                stream.thread_type = "FRAME"  # the next picture is drawn while this one is encoded
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"  # what every player can show
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
    return path


def _write_gif(reel: Reel, path_without_suffix: Path, progress: Progress) -> Path:
    path = path_without_suffix.with_name(path_without_suffix.name + ".gif")
    stride = max(2, math.ceil(reel.count / _GIF_FRAMES))
    frames = [_small(picture) for picture in _pictures(reel, stride, progress)]
    palette = _palette(frames[len(frames) // 2])  # one for all: what does not move then costs nothing
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    duration = round(1e3 * stride / reel.rate)
    first.save(path, save_all=True, append_images=others, duration=duration, loop=0, optimize=True)
    return path


def _palette(picture: Image.Image) -> Image.Image:
    """An image with a palette of common colours, for the landscape, and rare ones, for the lines of the diagrams."""
    common = picture.quantize(_GIF_COLOURS, Image.Quantize.MEDIANCUT).getpalette() or []
    rare = picture.quantize(_GIF_COLOURS, Image.Quantize.MAXCOVERAGE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(common[: 3 * _GIF_COLOURS] + rare[: 3 * _GIF_COLOURS])
    return palette


def _small(picture: Picture) -> Image.Image:
    height = round(_GIF_WIDTH * picture.shape[0] / picture.shape[1])
    return Image.fromarray(cv2.resize(picture, (_GIF_WIDTH, height), interpolation=cv2.INTER_AREA))
