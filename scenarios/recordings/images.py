"""Images of a sequence, read a few frames ahead in other threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from scenarios.image_file import pixel_size, read_grey
from scenarios.recordings.sequence import FrameFiles, StereoSequence
from sensors.messages import GreyImage, StereoFrame

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
                waiting.append((files, readers.submit(_read, files, size)))
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


def _read(files: FrameFiles, size: tuple[int, int]) -> StereoFrame | Dropped:
    try:
        left, right = (_sized(path, size) for path in (files.left, files.right))
    except ValueError as error:
        return Dropped(files, str(error))
    return StereoFrame(tick=files.tick, left=left, right=right)


def _sized(path: Path, size: tuple[int, int]) -> GreyImage:
    image = read_grey(path)
    if image.shape != size[::-1]:
        raise ValueError(f"{path} has {image.shape[1]}x{image.shape[0]} px, not {size[0]}x{size[1]}")
    return image
