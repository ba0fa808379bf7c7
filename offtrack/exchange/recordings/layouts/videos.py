"""Stereo images of videos, read by OpenCV: one with both cameras side by side, or ``left.*`` and ``right.*``."""

import os
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from offtrack.exchange.recordings.stereo_sequence import Wanted
from offtrack.exchange.recordings.writers import write_images
from scenarios.image_file import silent_stderr
from scenarios.progress import Progress
from sensors.messages import GreyImage
from vehicle.clock import TICK
from vehicle.foundation.user_file import MAX_FRAMES

_ENDINGS: Final = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v")
_BESIDE: Final = (".txt", ".toml", ".yaml", ".yml", ".xml")  # calibration and mounting


def fits(path: Path) -> bool:
    """True for one video with both cameras, or a folder with those of the left and the right one."""
    return bool(_videos(path))


def _videos(path: Path) -> tuple[Path, ...]:
    if path.is_file():
        return (path,) if path.suffix.lower() in _ENDINGS else ()
    left, right = ([path / f"{side}{ending}" for ending in _ENDINGS] for side in ("left", "right"))
    found = [next((file for file in files if file.is_file()), None) for files in (left, right)]
    return tuple(file for file in found if file) if all(found) else ()


def unpack(path: Path, folder: Path, wanted: Wanted, progress: Progress) -> tuple[str, ...]:
    """Write all frames and their times; calibration and mounting beside the videos come along.

    Frames of two videos are paired by their number.

    Raises:
        ValueError: one line, if a video can not be read or is too long.
    """
    videos = _videos(path)
    for side in ("left", "right"):
        (folder / side).mkdir()
    with silent_stderr():
        captures = [cv2.VideoCapture(str(video)) for video in videos]
    expected = int(min(capture.get(cv2.CAP_PROP_FRAME_COUNT) for capture in captures))
    times: list[float] = []
    while len(images := [one for capture in captures if (one := next_image(capture)) is not None]) == len(captures):
        if len(times) >= MAX_FRAMES:
            raise ValueError(f"{videos[0]}: more than {MAX_FRAMES} frames: cut the video")
        left, right = images if len(images) == 2 else np.split(images[0][:, : images[0].shape[1] // 2 * 2], 2, axis=1)
        write_images({folder / s / f"{len(times):06d}.pgm": i for s, i in (("left", left), ("right", right))})
        times.append(1e-3 * captures[0].get(cv2.CAP_PROP_POS_MSEC))
        progress(len(times), max(expected, len(times)), "unpacking")
    rate = captures[0].get(cv2.CAP_PROP_FPS) or 10.0
    for capture in captures:
        capture.release()
    if len(times) < 2:
        raise ValueError(f"{' and '.join(map(str, videos))}: {len(times)} frames can be read; at least 2 are needed")
    notes = [] if len(videos) == 2 else ["the left half of the video is the left camera's image"]
    if min(np.diff(times)) < 0.999 * TICK:
        times = [k / rate for k in range(len(times))]
        notes.append(f"times are those of {rate:g} frames a second")
    (folder / "times.txt").write_text("".join(f"{one:.6f}\n" for one in times), encoding="utf-8")
    for file in videos[0].parent.iterdir():
        if file.suffix in _BESIDE and file.name != "times.txt" and file.is_file():
            os.symlink(file.resolve(), folder / file.name)
    return tuple(notes)


def next_image(capture: Any) -> GreyImage | None:
    """Next image in grey; None at the end or after a failure."""
    with silent_stderr():
        read, image = capture.read()
    if not read:
        return None
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
