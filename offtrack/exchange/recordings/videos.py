"""Stereo images of videos, cameras and network streams, read by OpenCV.

A video shows both cameras side by side, or there are two, ``left.*`` and ``right.*``. Live, each source is a number of
a device, a file or an address; both are asked for their next image at the same moment.
"""

import contextlib
import json
import math
import os
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TextIO

import cv2
import numpy as np

from estimators.context import OffTrackingSource
from estimators.estimates import Health
from offtrack.exchange.recordings.stereo_reader import Recording
from offtrack.exchange.recordings.stereo_sequence import Unpacked
from scenarios.progress import Progress, no_progress
from sensors.messages import GreyImage, StereoFrame
from vehicle.clock import TICK
from vehicle.foundation.user_file import MAX_FRAMES

_ENDINGS: Final = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v")
_BESIDE: Final = (".txt", ".toml", ".yaml", ".yml", ".xml")  # calibration and mounting
_AGAIN: Final = 0.5  # between two attempts to open a lost source [s]


def videos_in(path: Path) -> tuple[Path, ...]:
    """One video with both cameras, or those of the left and the right one; empty if the path has none."""
    if path.is_file():
        return (path,) if path.suffix.lower() in _ENDINGS else ()
    left, right = ([path / f"{side}{ending}" for ending in _ENDINGS] for side in ("left", "right"))
    found = [next((file for file in files if file.is_file()), None) for files in (left, right)]
    return tuple(file for file in found if file) if all(found) else ()


@contextmanager
def unpacked_videos(videos: tuple[Path, ...], progress: Progress = no_progress) -> Iterator[Unpacked]:
    """Unpack one video or two into a folder as ``offtrack estimate`` reads it, and remove the folder at the end.

    Calibration and mounting beside the videos come along. Frames of two videos are paired by their number.

    Raises:
        ValueError: one line, if a video can not be read or is too long.
    """
    place = videos[0].parent
    with tempfile.TemporaryDirectory(prefix="offtrack-video-") as temporary:
        folder = Path(temporary) / (place.resolve().name if len(videos) == 2 else videos[0].stem)
        for side in ("left", "right"):
            (folder / side).mkdir(parents=True)
        captures = [cv2.VideoCapture(str(path)) for path in videos]
        expected = int(min(capture.get(cv2.CAP_PROP_FRAME_COUNT) for capture in captures))
        times: list[float] = []
        while (images := [_next(capture) for capture in captures]) and all(image is not None for image in images):
            if len(times) >= MAX_FRAMES:
                raise ValueError(f"{videos[0]}: more than {MAX_FRAMES} frames: cut the video")
            left, right = _halves(images[0]) if len(images) == 1 else images
            for side, image in (("left", left), ("right", right)):
                cv2.imwrite(str(folder / side / f"{len(times):06d}.pgm"), np.asarray(image))
            times.append(1e-3 * captures[0].get(cv2.CAP_PROP_POS_MSEC))
            progress(len(times), max(expected, len(times)), "unpacking")
        for capture in captures:
            capture.release()
        if len(times) < 2:
            names = " and ".join(map(str, videos))
            raise ValueError(f"{names}: {len(times)} frames can be read; at least 2 are needed")
        notes = [] if len(videos) == 2 else ["the left half of the video is the left camera's image"]
        if min(np.diff(times)) < 0.999 * TICK:
            rate = captures[0].get(cv2.CAP_PROP_FPS) or 10.0
            times = [k / rate for k in range(len(times))]
            notes.append(f"times are those of {rate:g} frames a second")
        (folder / "times.txt").write_text("".join(f"{one:.6f}\n" for one in times), encoding="utf-8")
        for file in place.iterdir():
            if file.suffix in _BESIDE and file.name != "times.txt" and file.is_file():
                os.symlink(file.resolve(), folder / file.name)
        try:
            yield Unpacked(folder, tuple(notes))
        except ValueError as error:
            raise ValueError(str(error).replace(str(folder), str(place))) from error


def _halves(image: GreyImage | None) -> tuple[GreyImage, GreyImage]:
    width = 0 if image is None else image.shape[1] // 2
    whole = np.zeros((0, 0), np.uint8) if image is None else image
    return whole[:, :width], whole[:, width : 2 * width]


def _next(capture: Any) -> GreyImage | None:
    """Next image in grey; None at the end or after a failure."""
    read, image = capture.read()
    return _grey(image) if read else None


def _grey(image: Any) -> GreyImage:
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


class Streams:
    """Two live sources of images."""

    def __init__(self, left: str, right: str) -> None:
        """Open devices (numbers), files or addresses."""
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # a lost source is said here
        self._names = left, right
        self._captures = [self._opened(name) for name in self._names]

    @staticmethod
    def _opened(name: str) -> Any:
        return cv2.VideoCapture(int(name) if name.isdecimal() else name)

    def read(self) -> tuple[GreyImage, GreyImage] | str:
        """A pair of images taken together, or why there is none; a lost source is opened again at the next call."""
        taken = [capture.grab() for capture in self._captures]  # decoding would take time between the two
        images = [one.retrieve() if good else (False, None) for one, good in zip(self._captures, taken, strict=True)]
        lost = [k for k, (good, _) in enumerate(images) if not good]
        if not lost:
            left, right = (_grey(image) for _, image in images)
            return left, right
        time.sleep(_AGAIN)
        for k in lost:
            self._captures[k].release()
            self._captures[k] = self._opened(self._names[k])
        return f"no image from {' and '.join(self._names[k] for k in lost)}"

    def close(self) -> None:
        """Release both sources."""
        for capture in self._captures:
            capture.release()


def estimate_live(streams: Streams, recording: Recording, source: OffTrackingSource, out: TextIO) -> dict[str, Any]:
    """Write a line of JSON for every pair, until an interrupt; return the summary.

    A pair that is missing, or of another size than the recording's, is a lost estimate.
    """
    memory, begin, counts = source.init(), time.monotonic(), Counter[str]()
    with contextlib.suppress(KeyboardInterrupt, BrokenPipeError):
        while True:
            pair = streams.read()
            tick = round((time.monotonic() - begin) / TICK)
            line: dict[str, Any] = {"time_s": round(tick * TICK, 3), "health": Health.LOST.name.lower()}
            if isinstance(pair, str):
                line["reason"] = pair
            elif any(image.shape != recording.size[::-1] for image in pair):
                line["reason"] = f"images are not of {recording.size[0]}x{recording.size[1]} px"
            else:
                frame = recording.rectified(StereoFrame(tick=tick, left=pair[0], right=pair[1]))
                memory, result = source.step(memory, frame)
                found: Any = getattr(result, "off_tracking", result)
                if found is None:
                    line["reason"] = "first image"
                else:
                    line["health"] = found.health.name.lower()
                    if found.health is not Health.LOST and math.isfinite(found.value):
                        line |= {"off_tracking_m": round(found.value, 6), "std_m": round(found.std, 6)}
            counts[line["health"]] += 1
            out.write(json.dumps(line) + "\n")
            out.flush()
    duration = time.monotonic() - begin
    pairs = sum(counts.values())
    return {"duration_s": round(duration, 3), "pairs": pairs, "pairs_per_s": round(pairs / duration, 2), **counts}
