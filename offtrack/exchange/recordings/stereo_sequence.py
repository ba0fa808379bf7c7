"""Stereo images of a recording's folder: files of each pair, capture times, and reading a few frames ahead.

The folders have the names of the KITTI odometry benchmark or one of two plain pairs of names. ``times.txt`` contains a
time in seconds for every frame, in order.
"""

import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from offtrack.exchange.recordings.file_pairs import file_pairs, read_times
from scenarios.image_file import grey_bits, images_in, pixel_size, read_grey
from sensors.messages import GreyImage, StereoFrame
from vehicle.clock import TICK
from vehicle.foundation.quantity import check_number

_PAUSE = 1.0  # time between frames that is noted [s]
_LOOKED_AT = 5  # frames whose images tell how many bits are used


class Layout(NamedTuple):
    """Names of the two cameras' folders and of their projections in KITTI's ``calib.txt``."""

    left: str
    right: str
    left_projection: str
    right_projection: str


LAYOUTS: Final = (
    Layout("image_0", "image_1", "P0", "P1"),
    Layout("image_2", "image_3", "P2", "P3"),
    Layout("image_left", "image_right", "P0", "P1"),
    Layout("left", "right", "P0", "P1"),
    Layout("image_00/data", "image_01/data", "P_rect_00", "P_rect_01"),  # KITTI raw
    Layout("image_02/data", "image_03/data", "P_rect_02", "P_rect_03"),
    Layout("mav0/cam0/data", "mav0/cam1/data", "P0", "P1"),  # EuRoC
    Layout("cam0/data", "cam1/data", "P0", "P1"),
    Layout("cam0", "cam1", "P0", "P1"),
)
_TABLES: Final = ("times.txt", "timestamps.txt", "data.csv")  # of the frames' times


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFiles:
    """Expected image files of a frame; they are not read yet and may be missing."""

    tick: int
    time: float  # as recorded [s]
    line: int  # of the frame in ``times.txt`` and ``poses.txt``, counted from 0
    left: Path
    right: Path
    bits: int = 16  # that images of 16 bits use


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoSequence:
    """The frames of a folder, oldest first."""

    directory: Path
    layout: Layout
    frames: tuple[FrameFiles, ...]
    lines: int  # required number of lines of ``times.txt`` and ``poses.txt``
    notes: tuple[str, ...] = ()  # on irregularities


class Unpacked(NamedTuple):
    """Folder with the recording of a bag or video, and what was noticed."""

    folder: Path
    notes: tuple[str, ...] = ()


def find_sequence(
    directory: Path, rate_hz: float | None = None, *, folders: tuple[str, str] | None = None, exchange: bool = False
) -> StereoSequence:
    """Find the stereo sequence in a folder.

    A gap in the numbers of the file names is a missing frame, so that times and poses stay with their images.

    Args:
        directory: contains two folders of images with the names of a layout.
        rate_hz: replaces the times of the frames.
        folders: names of the folders of the left and the right images, instead of a layout's.
        exchange: takes the right images for left ones.

    Raises:
        ValueError: one line, if a folder of images is missing, or if times are missing or wrong.
    """
    layout = _layout(directory, folders)
    left, right, numbered, stamps, notes = file_pairs(
        images_in(directory / layout.left), images_in(directory / layout.right)
    )
    if exchange:
        left, right = right, left
    keys = sorted(left.keys() | right.keys())
    every = range(keys[0], keys[-1] + 1)
    table = _table(directory, layout)
    if rate_hz is not None:
        check_number("--rate", rate_hz, 0.0, 1.0 / TICK, "Hz", above=True)
        times: Sequence[float] = [k / rate_hz for k in range(len(every))]
        timed = _TimedFrames(tuple(every), 0)
    elif stamps and not os.path.lexists(table):
        times, timed = stamps, _TimedFrames(tuple(keys), 0, ("times are those of the file names",))
    else:
        times, of_table = read_times(table)
        timed = _timed_frames(keys, len(times), directory, numbered=numbered)
        notes = (*notes, *of_table)
    some = [side[key] for key in keys[:: max(1, len(keys) // _LOOKED_AT)] for side in (left, right) if key in side]
    bits = grey_bits(some)
    if bits < 16:
        notes = (*notes, f"images of 16 bits use {bits} of them")
    frames = []
    for line, key in enumerate(timed.keys, start=timed.first_line):
        name = (left.get(key) or right.get(key) or Path(f"{key:06d}.png")).name
        frames.append(
            FrameFiles(
                tick=round((times[line] - times[timed.first_line]) / TICK),
                time=times[line],
                line=line,
                left=left.get(key, directory / layout.left / name),
                right=right.get(key, directory / layout.right / name),
                bits=bits,
            )
        )
    notes = (*notes, *timed.notes, *_pauses(frames))
    return StereoSequence(directory=directory, layout=layout, frames=tuple(frames), lines=len(times), notes=notes)


def _pauses(frames: Sequence[FrameFiles]) -> list[str]:
    """A note on the longest time between two frames, if it stands out."""
    steps = np.diff([files.time for files in frames])
    if not len(steps) or steps.max() < max(_PAUSE, 10.0 * float(np.median(steps))):
        return []
    return [f"no images for {steps.max():.1f} s after {frames[int(steps.argmax())].left.name}: are the times right?"]


def _table(directory: Path, layout: Layout) -> Path:
    """Table of the frames' times: in the folder, or beside the left images; ``times.txt`` if there is none."""
    places = directory, (directory / layout.left).parent, directory / layout.left
    found = (place / name for place in places for name in _TABLES if os.path.lexists(place / name))
    return next(found, directory / _TABLES[0])


def _layout(directory: Path, folders: tuple[str, str] | None = None) -> Layout:
    """The layout with these folders, or the first one whose two folders exist."""
    if not directory.is_dir():
        raise ValueError(f"{directory} is not a folder; name the folder that contains image_0 and image_1")
    if folders is not None:
        for name in folders:
            if not (directory / name).is_dir():
                raise ValueError(f"--folders {','.join(folders)}: {directory / name} is no folder")
        return Layout(*folders, "P0", "P1")
    for layout in LAYOUTS:
        exists = [(directory / name).is_dir() for name in layout[:2]]
        if all(exists):
            return layout
        if any(exists):
            missing = layout.right if exists[0] else layout.left
            raise ValueError(f"{directory / missing} is missing: a stereo recording needs the images of both cameras")
    pairs = ", ".join(f"{layout.left} and {layout.right}" for layout in LAYOUTS)
    raise ValueError(f"{directory} contains no stereo images; it needs two folders: {pairs}, or --folders LEFT,RIGHT")


class _TimedFrames(NamedTuple):
    """Frames that belong to the lines of ``times.txt``."""

    keys: tuple[int, ...]
    first_line: int
    notes: tuple[str, ...] = ()


def _timed_frames(keys: Sequence[int], lines: int, directory: Path, *, numbered: bool) -> _TimedFrames:
    """Assign this number of lines to frames, where there is only one sensible way."""
    every = tuple(range(keys[0], keys[-1] + 1))
    if lines == len(every):
        return _TimedFrames(every, 0)
    if lines == len(keys):
        return _TimedFrames(tuple(keys), 0)
    if numbered and lines > keys[-1]:  # images of a part, times of the whole sequence
        return _TimedFrames(
            every, keys[0], (f"times.txt has {lines} lines, {lines - len(every)} of them without images",)
        )
    if lines == len(every) - 1 > 0:
        return _TimedFrames(every[:-1], 0, (f"the last frame has no line in times.txt and is omitted: {keys[-1]}",))
    raise ValueError(
        f"{directory / 'times.txt'} has {lines} lines for {len(keys)} frames; it needs one line per frame. "
        "Repair it or use --rate HZ"
    )


_AHEAD = 4  # frames that are read in advance: reading then costs no time in the odometry's thread


class Dropped(NamedTuple):
    """A frame that could not be used."""

    files: FrameFiles
    reason: str  # one line that names the file


def image_size(sequence: StereoSequence) -> tuple[int, int]:
    """Width and height [px] of the sequence's images, taken from the first readable pair.

    Raises:
        ValueError: one line, if no pair can be read, or if the images of the two cameras differ in size.
    """
    first = ""
    for files in sequence.frames:
        try:
            left, right = (pixel_size(path) for path in (files.left, files.right))
        except ValueError as error:
            first = first or str(error)
            continue
        if left != right:
            raise ValueError(
                f"{files.right} has {right[0]}x{right[1]} px and {files.left} {left[0]}x{left[1]} px: "
                "the images of both cameras must have the same size"
            )
        return left
    raise ValueError(f"{sequence.directory}: no pair of images can be read. First reason: {first}")


def stream(frames: Sequence[FrameFiles], size: tuple[int, int]) -> Iterator[tuple[FrameFiles, StereoFrame | Dropped]]:
    """All frames in order, read in advance; an unusable frame is replaced by the reason."""
    waiting: deque[tuple[FrameFiles, Future[StereoFrame | Dropped]]] = deque()
    with ThreadPoolExecutor(max_workers=2, thread_name_prefix="images") as readers:
        try:
            for files in frames:
                waiting.append((files, readers.submit(read_frame, files, size)))
                if len(waiting) > _AHEAD:
                    yield _next(waiting)
            while waiting:
                yield _next(waiting)
        finally:
            for _, future in waiting:
                future.cancel()


def _next(
    waiting: deque[tuple[FrameFiles, Future[StereoFrame | Dropped]]],
) -> tuple[FrameFiles, StereoFrame | Dropped]:
    files, future = waiting.popleft()
    return files, future.result()


def read_frame(files: FrameFiles, size: tuple[int, int]) -> StereoFrame | Dropped:
    """The frame of images of this width and height [px], or why it can not be used."""
    try:
        left, right = (_sized(path, size, files.bits) for path in (files.left, files.right))
    except ValueError as error:
        return Dropped(files, str(error))
    return StereoFrame(tick=files.tick, left=left, right=right)


def _sized(path: Path, size: tuple[int, int], bits: int) -> GreyImage:
    image = read_grey(path, bits)
    if image.shape != size[::-1]:
        raise ValueError(f"{path} has {image.shape[1]}x{image.shape[0]} px, not {size[0]}x{size[1]}")
    return image
