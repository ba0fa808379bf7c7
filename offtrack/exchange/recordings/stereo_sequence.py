"""Frames of a stereo recording as files of images, and reading them a few frames ahead."""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from scenarios.image_file import pixel_size, read_grey
from sensors.messages import GreyImage, StereoFrame


class Wanted(NamedTuple):
    """What the user says of a recording."""

    topics: Mapping[str, str] = {}  # of a bag by role: left, right, left_info, right_info; others by their names
    exchange: bool = False  # right images are left ones
    calibrated: bool = False  # by a file of the user's own: a bag's images stay as they are


class Folders(NamedTuple):
    """Names of the two cameras' folders and of their projections in KITTI's ``calib.txt``."""

    left: str
    right: str
    left_projection: str = "P0"
    right_projection: str = "P1"


class FrameFiles(NamedTuple):
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
    folders: Folders
    frames: tuple[FrameFiles, ...]
    lines: int  # required number of lines of ``times.txt`` and ``poses.txt``
    notes: tuple[str, ...] = ()  # on irregularities


class Dropped(NamedTuple):
    """Why a frame could not be used: one line that names the file."""

    reason: str


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


_AHEAD = 4  # frames that are read in advance: reading then costs no time in the odometry's thread


def stream(
    frames: Sequence[FrameFiles], size: tuple[int, int], seen: Mapping[FrameFiles, StereoFrame | Dropped] | None = None
) -> Iterator[tuple[FrameFiles, StereoFrame | Dropped]]:
    """All frames in order, read in advance unless already ``seen``; an unusable frame is replaced by the reason."""
    coming = iter(frames)
    waiting: deque[tuple[FrameFiles, Future[StereoFrame | Dropped] | None]] = deque()
    known = seen or {}
    with ThreadPoolExecutor(max_workers=2, thread_name_prefix="images") as readers:
        try:
            while True:
                more = islice(coming, 1 + _AHEAD - len(waiting))
                waiting.extend((one, None if one in known else readers.submit(read_frame, one, size)) for one in more)
                if not waiting:
                    return
                files, future = waiting.popleft()
                yield files, future.result() if future else known[files]
        finally:
            for _, future in waiting:
                if future:
                    future.cancel()


def read_frame(files: FrameFiles, size: tuple[int, int]) -> StereoFrame | Dropped:
    """The frame of images of this width and height [px], or why it can not be used."""
    try:
        left, right = (_sized(path, size, files.bits) for path in (files.left, files.right))
    except ValueError as error:
        return Dropped(str(error))
    return StereoFrame(tick=files.tick, left=left, right=right)


def _sized(path: Path, size: tuple[int, int], bits: int) -> GreyImage:
    image = read_grey(path, bits)
    if image.shape != size[::-1]:
        raise ValueError(f"{path} has {image.shape[1]}x{image.shape[0]} px, not {size[0]}x{size[1]}")
    return image
