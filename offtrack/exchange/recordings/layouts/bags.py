"""ROS bags with stereo images: a folder of a ROS 2 bag, or of its files alone, or one file, of ROS 1 too.

Images are kept as they are if the bag holds the files of a recording of offtrack; else raw images are rectified as
their CameraInfo says.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from offtrack.exchange.recordings.layouts.bag_cameras import Rectification, bag_cameras, rectified
from offtrack.exchange.recordings.layouts.bag_files import Bag, bag_files, opened_bag
from offtrack.exchange.recordings.layouts.bag_images import grey_image
from offtrack.exchange.recordings.layouts.bag_topics import SIDES, stereo_topics
from offtrack.exchange.recordings.layouts.file_pairs import nearest_pairs
from offtrack.exchange.recordings.stereo_sequence import Wanted
from offtrack.exchange.recordings.writers import write_images
from scenarios.progress import Progress
from vehicle.foundation.user_file import MAX_FRAMES

RECORDING: Final = "/offtrack/recording"  # files of a recording of offtrack: calibration, mounting, true poses
_FILES: Final = ("calib.txt", "rig.toml", "poses.txt")
_FOLDERS: Final = ("image_0", "image_1")


def fits(path: Path) -> bool:
    """True for the folder or the file of a bag."""
    return (path / "metadata.yaml").is_file() or bool(bag_files(path))


def unpack(path: Path, folder: Path, wanted: Wanted, progress: Progress) -> tuple[str, ...]:
    """Write pairs of images with their times, and the calibration.

    Raises:
        ValueError: one line, if the package is missing, or the bag can not be read or used.
    """
    with opened_bag(path, folder.parent / "files of the bag") as bag:
        topics = stereo_topics(bag.kinds, wanted.topics)
        files, found = _recording_files(bag), Rectification()
        if not wanted.calibrated and not files.keys() & {"calib.txt", "rig.toml"}:
            found = bag_cameras(bag, topics, exchange=wanted.exchange)
            files["calib.txt"] = found.calibration
        stamps, notes = _write_images(bag, topics.images, folder, found, progress)
        pairs = nearest_pairs(stamps[0], stamps[1], 1e-6, "its topics")
    for name, kept in zip(_FOLDERS, pairs[:2], strict=True):
        _number(folder / name, kept)
    times = (1e-9 * stamps[0][pairs.left]).tolist()
    files["times.txt"] = "".join(f"{time:.9f}\n" for time in times)
    for name, text in files.items():
        if name != "poses.txt" or len(text.splitlines()) == len(times):
            (folder / name).write_text(text, encoding="utf-8")
    return (*found.notes, *notes, *pairs.notes)


def _recording_files(bag: Bag) -> dict[str, str]:
    """Files of a recording of offtrack that the bag holds."""
    if bag.kinds.get(RECORDING) != "std_msgs/msg/String":
        return {}
    first = next(bag.messages(RECORDING), None)
    files = json.loads(first.message.data) if first else {}
    return {name: str(files[name]) for name in _FILES if name in files}


def _write_images(
    bag: Bag, topics: Sequence[str], folder: Path, found: Rectification, progress: Progress
) -> tuple[list[NDArray[np.int64]], list[str]]:
    """Write every image under its number; return the stamps [ns] of each side, of one clock, and a note on it."""
    stamps: tuple[list[tuple[int, int]], ...] = ([], [])
    for name in _FOLDERS:
        (folder / name).mkdir()
    total = bag.count(*topics)
    for done, (topic, received, message) in enumerate(bag.messages(*topics), start=1):
        side = topics.index(topic)
        if len(stamps[side]) >= MAX_FRAMES:
            raise ValueError(f"more than {MAX_FRAMES} images of the {SIDES[side]} camera: cut the bag")
        image = rectified(grey_image(message, topic), found.maps[side])
        write_images({folder / _FOLDERS[side] / f"{len(stamps[side])}.pgm": image})
        stamp = message.header.stamp
        stamps[side].append((stamp.sec * 1_000_000_000 + stamp.nanosec, received))
        progress(done, max(total, done), "unpacking")
    both = [np.array(one, dtype=np.int64).reshape(-1, 2) for one in stamps]
    sent = all(one[:, 0].all() for one in both)
    notes = [] if sent else ["messages without a time stamp: times are those of their reception"]
    return [one[:, 0 if sent else 1] for one in both], notes


def _number(folder: Path, kept: NDArray[np.intp]) -> None:
    """Number the images anew; remove the others."""
    for k, number in enumerate(kept):
        (folder / f"{number}.pgm").rename(folder / f"frame{k:06d}.pgm")
    for path in folder.glob("[0-9]*.pgm"):
        path.unlink()
