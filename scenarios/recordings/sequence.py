"""A folder of stereo images as a sequence of frames: which files belong together, and when they were taken.

Known are the folder names of the KITTI odometry benchmark and two plain ones; ``times.txt`` holds a time in seconds for
every frame, in order.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from vehicle.clock import TICK

_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".bmp", ".tif", ".tiff")
_NO_NUMBER = -1
_LONGEST_PERIOD = 10.0  # between frames; more is a time in milliseconds, or a recording that shows no motion [s]


class Layout(NamedTuple):
    """Names of the folders of the two cameras, and of their projections in KITTI's ``calib.txt``."""

    left: str
    right: str
    left_projection: str
    right_projection: str


LAYOUTS: Final = (
    Layout("image_0", "image_1", "P0", "P1"),
    Layout("image_2", "image_3", "P2", "P3"),
    Layout("image_left", "image_right", "P0", "P1"),
    Layout("left", "right", "P0", "P1"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFiles:
    """Where the two images of a frame should be; whether they can be read turns out when they are."""

    tick: int
    time: float  # as recorded [s]
    line: int  # of the frame in ``times.txt`` and ``poses.txt``, counted from 0
    left: Path
    right: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoSequence:
    """The frames of a folder, oldest first."""

    directory: Path
    layout: Layout
    frames: tuple[FrameFiles, ...]
    lines: int  # that ``times.txt`` and ``poses.txt`` have to have
    notes: tuple[str, ...] = ()  # what is odd about it


def find_sequence(directory: Path, rate_hz: float | None = None) -> StereoSequence:
    """The stereo sequence in a folder; ``rate_hz`` takes the place of its ``times.txt``.

    A number missing from the file names is a missing frame, so that times and poses stay with their images.

    Raises:
        ValueError: one line, if there are no two folders of images, no times, or wrong ones.
    """
    layout = _layout(directory)
    left, right, numbered = _keyed(_images(directory / layout.left), _images(directory / layout.right))
    keys = sorted(left.keys() | right.keys())
    every = range(keys[0], keys[-1] + 1)
    if rate_hz is not None:
        times = _times_at(rate_hz, len(every))
        fitted = _Fitted(tuple(every), 0)
    else:
        times = _read_times(directory / "times.txt")
        fitted = _fitted(keys, len(times), directory, numbered=numbered)
    frames = []
    for line, key in enumerate(fitted.keys, start=fitted.first_line):
        name = (left.get(key) or right.get(key) or Path(f"{key:06d}.png")).name
        frames.append(
            FrameFiles(
                tick=round((times[line] - times[fitted.first_line]) / TICK),
                time=times[line],
                line=line,
                left=left.get(key, directory / layout.left / name),
                right=right.get(key, directory / layout.right / name),
            )
        )
    return StereoSequence(
        directory=directory, layout=layout, frames=tuple(frames), lines=len(times), notes=fitted.notes
    )


def _layout(directory: Path) -> Layout:
    """The first layout of which both folders are there."""
    if not directory.is_dir():
        raise ValueError(f"{directory} is no folder; name the one that holds image_0 and image_1")
    for layout in LAYOUTS:
        there = [(directory / name).is_dir() for name in layout[:2]]
        if all(there):
            return layout
        if any(there):
            missing = layout.right if there[0] else layout.left
            raise ValueError(f"{directory / missing} is missing: a stereo recording has images of both cameras")
    pairs = ", ".join(f"{layout.left} and {layout.right}" for layout in LAYOUTS)
    raise ValueError(
        f"{directory} holds no stereo images: two folders are needed, {pairs.replace(', left', ' or left')}"
    )


def _images(folder: Path) -> list[Path]:
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    if not files:
        raise ValueError(f"{folder} holds no images ({', '.join(kind.lstrip('.') for kind in _SUFFIXES)})")
    return files


class _Keyed(NamedTuple):
    """Both cameras' files by frame."""

    left: dict[int, Path]
    right: dict[int, Path]
    numbered: bool  # by the numbers in their names; else counted in the order of the names


def _keyed(left: list[Path], right: list[Path]) -> _Keyed:
    """Files by the last number in their names; where there is none, or it is a time stamp, by their order."""
    sides = [[_number(path) for path in files] for files in (left, right)]
    distinct = all(len(set(side)) == len(side) and _NO_NUMBER not in side for side in sides)
    if distinct and max(map(max, sides)) - min(map(min, sides)) < 2 * max(map(len, sides)):
        keyed = [{_number(path): path for path in files} for files in (left, right)]
        return _Keyed(keyed[0], keyed[1], numbered=True)
    names = [{f"{_number(path):030d}" if distinct else path.stem: path for path in files} for files in (left, right)]
    rank = {name: k for k, name in enumerate(sorted(names[0].keys() | names[1].keys()))}
    keyed = [{rank[name]: path for name, path in side.items()} for side in names]
    return _Keyed(keyed[0], keyed[1], numbered=False)


def _number(path: Path) -> int:
    digits = re.findall(r"\d+", path.stem)
    return int(digits[-1]) if digits else _NO_NUMBER


class _Fitted(NamedTuple):
    """Which frames the lines of ``times.txt`` speak of."""

    keys: tuple[int, ...]
    first_line: int
    notes: tuple[str, ...] = ()


def _fitted(keys: Sequence[int], lines: int, directory: Path, *, numbered: bool) -> _Fitted:
    """The frames that so many lines of times belong to, if there is a plain way to tell."""
    every = tuple(range(keys[0], keys[-1] + 1))
    if lines == len(every):
        return _Fitted(every, 0)
    if lines == len(keys):
        return _Fitted(tuple(keys), 0)
    if numbered and lines > keys[-1]:  # a part of a longer sequence, with the times of all of it
        return _Fitted(every, keys[0], (f"times.txt has {lines} lines, {lines - len(every)} of them without images",))
    if lines == len(every) - 1:
        return _Fitted(every[:-1], 0, (f"the last frame has no line in times.txt and is left out: {keys[-1]}",))
    raise ValueError(
        f"{directory / 'times.txt'} has {lines} lines for {len(keys)} frames: it needs one for each; "
        "repair it, or give --rate HZ instead"
    )


def _times_at(rate_hz: float, count: int) -> list[float]:
    if not 0.0 < rate_hz <= 1.0 / TICK:
        raise ValueError(f"--rate = {rate_hz:g} Hz must be above 0 and at most {1.0 / TICK:g}")
    return [k / rate_hz for k in range(count)]


def _read_times(path: Path) -> list[float]:
    """Times [s], each at least a tick after the one before."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise ValueError(f"{path} is missing: write the time of every frame in it [s], or give --rate HZ") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    times = [_time(path, k, line) for k, line in enumerate(lines, start=1) if line.strip()]
    for k, (before, after) in enumerate(pairwise(times), start=2):
        if after - before < 0.999 * TICK:
            raise ValueError(
                f"{path}, line {k}: {after:g} s must be at least {TICK:g} s after the line before; "
                "repair it, or give --rate HZ instead"
            )
    if len(times) > 1 and (times[-1] - times[0]) / (len(times) - 1) > _LONGEST_PERIOD:
        raise ValueError(
            f"{path}: {(times[-1] - times[0]) / (len(times) - 1):g} s from frame to frame is more than "
            f"{_LONGEST_PERIOD:g} s; times must be in seconds (or give --rate HZ instead)"
        )
    return times


def _time(path: Path, number: int, line: str) -> float:
    try:
        time = float(line.split()[0])
    except ValueError:
        raise ValueError(f"{path}, line {number}: '{line.strip()[:40]}' is not a time [s]") from None
    if not math.isfinite(time):
        raise ValueError(f"{path}, line {number}: {time} is not a time [s]")
    return time
