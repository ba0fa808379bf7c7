"""Two folders of images, with the names that one program or another gives them."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from offtrack.exchange.recordings.layouts.file_pairs import file_pairs
from offtrack.exchange.recordings.layouts.frame_times import TimedFrames, pause_notes, read_times, timed_frames
from offtrack.exchange.recordings.stereo_sequence import Folders, FrameFiles, StereoSequence
from scenarios.image_file import grey_bits, images_in
from vehicle.clock import TICK
from vehicle.foundation.quantity import check_number

FOLDERS: Final = (
    Folders("image_0", "image_1"),  # KITTI odometry: grey, colour
    Folders("image_2", "image_3", "P2", "P3"),
    Folders("image_left", "image_right"),
    Folders("left", "right"),
    Folders("image_00/data", "image_01/data", "P_rect_00", "P_rect_01"),  # KITTI raw
    Folders("image_02/data", "image_03/data", "P_rect_02", "P_rect_03"),
    Folders("mav0/cam0/data", "mav0/cam1/data"),  # EuRoC
    Folders("cam0/data", "cam1/data"),
    Folders("cam0", "cam1"),
)
_TABLES: Final = ("times.txt", "timestamps.txt", "data.csv")  # of the frames' times
_LOOKED_AT = 5  # frames whose images tell how many bits are used


def find_sequence(
    directory: Path, rate_hz: float | None = None, *, folders: tuple[str, str] | None = None, exchange: bool = False
) -> StereoSequence:
    """Find the stereo sequence in a folder.

    A gap in the numbers of the file names is a missing frame, so that times and poses stay with their images.

    Args:
        directory: contains two folders of images.
        rate_hz: replaces the times of the frames.
        folders: names of the folders of the left and the right images, instead of known ones.
        exchange: takes the right images for left ones.

    Raises:
        ValueError: one line, if a folder of images is missing, or if times are missing or wrong.
    """
    names = _named(directory, folders)
    pairs = file_pairs(images_in(directory / names.left), images_in(directory / names.right))
    left, right = (pairs.right, pairs.left) if exchange else (pairs.left, pairs.right)
    keys = sorted(left.keys() | right.keys())
    table = _table(directory, names)
    if rate_hz is not None:
        check_number("--rate", rate_hz, 0.0, 1.0 / TICK, "Hz", above=True)
        timed = TimedFrames(tuple(range(keys[0], keys[-1] + 1)), 0)
        times: Sequence[float] = [k / rate_hz for k in range(len(timed.keys))]
    elif pairs.times and not os.path.lexists(table):
        times, timed = pairs.times, TimedFrames(tuple(keys), 0, ("times are those of the file names",))
    else:
        times, of_table = read_times(table)
        timed = timed_frames(keys, len(times), table, of_table, numbered=pairs.numbered)
    bits = grey_bits(
        side[key] for key in keys[:: max(1, len(keys) // _LOOKED_AT)] for side in (left, right) if key in side
    )
    frames, first = [], times[timed.first_line]
    for line, key in enumerate(timed.keys, start=timed.first_line):
        name = (left.get(key) or right.get(key) or Path(f"{key:06d}.png")).name
        one, other = left.get(key, directory / names.left / name), right.get(key, directory / names.right / name)
        frames.append(FrameFiles(round((times[line] - first) / TICK), times[line], line, one, other, bits))
    of_bits = [f"images of 16 bits use {bits} of them"] * (bits < 16)
    notes = (*pairs.notes, *timed.notes, *of_bits, *pause_notes(frames))
    return StereoSequence(directory=directory, folders=names, frames=tuple(frames), lines=len(times), notes=notes)


def _table(directory: Path, names: Folders) -> Path:
    """Table of the frames' times: in the folder, or beside the left images; ``times.txt`` if there is none."""
    places = directory, (directory / names.left).parent, directory / names.left
    found = (place / name for place in places for name in _TABLES if os.path.lexists(place / name))
    return next(found, directory / _TABLES[0])


def _named(directory: Path, folders: tuple[str, str] | None) -> Folders:
    """These folders, or the first known ones of which both exist."""
    if not directory.is_dir():
        raise ValueError(f"{directory} is not a folder; name the folder that contains image_0 and image_1")
    lacking = []
    for known in FOLDERS if folders is None else (Folders(*folders),):
        missing = [name for name in known[:2] if not (directory / name).is_dir()]
        if not missing:
            return known
        if folders is not None:
            raise ValueError(f"--folders {','.join(folders)}: {directory / missing[0]} is no folder")
        lacking += missing * (len(missing) == 1)
    if lacking:
        raise ValueError(f"{directory / lacking[0]} is missing: a stereo recording needs the images of both cameras")
    pairs = ", ".join(f"{known.left} and {known.right}" for known in FOLDERS)
    raise ValueError(f"{directory} contains no stereo images; it needs two folders: {pairs}, or --folders LEFT,RIGHT")
