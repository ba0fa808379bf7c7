"""Frames of a recording by its files: pairs of images by their names, and capture times.

A name is read as its numbers. Those that are the same in all names of a camera, as an image size or a date, say
nothing. Tables of times have one line per frame: a time, or the frame's number and then its time (DSO), or a time and
a file name (TUM, EuRoC), or date and time (KITTI raw). Unix times may be in seconds, milliseconds, microseconds or
nanoseconds.
"""

import os
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from vehicle.clock import TICK
from vehicle.foundation.user_file import MAX_FRAMES, FileKind, read_text, shown

_Key: TypeAlias = tuple[Decimal, ...]
_NEAR: Final = 0.5  # of the time between frames; images farther apart are no pair
_PAIRED: Final = 0.5  # least share of the left images that have a right one


class FilePairs(NamedTuple):
    """Left and right image files by frame; files of a frame may be missing."""

    left: Mapping[int, Path]
    right: Mapping[int, Path]
    numbered: bool = False  # True if names have the numbers of frames, so that a gap is a missing frame
    times: tuple[float, ...] = ()  # of the frames in order, by time stamps in the names [s]
    notes: tuple[str, ...] = ()


def file_pairs(left: Sequence[Path], right: Sequence[Path]) -> FilePairs:
    """Pair the image files of two cameras, oldest first.

    Raises:
        ValueError: one line, if the names do not tell which images are pairs.
    """
    numbers = [_numbers(side) for side in (left, right)]
    if not numbers[0] or not numbers[1]:
        return _ranked({path.stem: path for path in left}, {path.stem: path for path in right})
    sides = [dict(zip(keys, files, strict=True)) for keys, files in zip(numbers, (left, right), strict=True)]
    ordered = [[side[key] for key in sorted(side)] for side in sides]
    notes = tuple(_order_notes(left, ordered[0]))
    by_order = f"paired by order, beginning with {ordered[0][0].name} and {ordered[1][0].name}"
    shift = _constant_shift(*sides)
    if shift:
        return _in_order(*ordered)._replace(notes=(*notes, f"{by_order}: right numbers are larger by {shift}"))
    if 2 * len(sides[0].keys() & sides[1].keys()) >= min(map(len, sides)):
        frames = {key[0] for side in sides for key in side if len(key) == 1 and key[0] == int(key[0])}
        if len(frames) == len(sides[0].keys() | sides[1].keys()) and max(frames) - min(frames) < 2 * len(frames):
            counted, right_counted = ({int(key[0]): path for key, path in side.items()} for side in sides)
            return FilePairs(counted, right_counted, numbered=True, notes=notes)
        return _ranked(*sides)._replace(notes=notes, times=_stamps(sorted(sides[0].keys() | sides[1].keys())))
    stamps = [_stamps(sorted(side)) for side in sides]
    if all(stamps):
        return _by_stamp(ordered, stamps)
    if len(left) == len(right):
        return _in_order(*ordered)._replace(notes=(*notes, by_order))
    raise ValueError(
        f"{left[0].parent} has {len(left)} images and {right[0].parent} {len(right)}, and names such as {left[0].name} "
        f"and {right[0].name} do not tell which are pairs: number both alike"
    )


def _numbers(files: Sequence[Path]) -> list[_Key]:
    """The numbers of each name that differ between names; empty if they do not tell the names apart."""
    numbers = [tuple(map(Decimal, re.findall(r"\d{9,}\.\d+|\d+", path.stem))) for path in files]
    if len({len(of_name) for of_name in numbers}) > 1 or not numbers[0]:
        return []
    differ = [k for k, column in enumerate(zip(*numbers, strict=True)) if len(set(column)) > 1] or [-1]
    keys = [tuple(of_name[k] for k in differ) for of_name in numbers]
    return keys if len(set(keys)) == len(keys) else []


def _ranked(left: Mapping[Any, Path], right: Mapping[Any, Path]) -> FilePairs:
    """Frames in the order of the keys of both sides."""
    rank = {key: k for k, key in enumerate(sorted(left.keys() | right.keys()))}
    one, other = ({rank[key]: path for key, path in side.items()} for side in (left, right))
    return FilePairs(one, other)


def _in_order(left: Sequence[Path], right: Sequence[Path]) -> FilePairs:
    return FilePairs(dict(enumerate(left)), dict(enumerate(right)))


def _order_notes(files: Sequence[Path], ordered: Sequence[Path]) -> list[str]:
    """A note if the last number of each name, alone, would give another order."""
    if sorted(files, key=lambda path: int(re.findall(r"\d+", path.stem)[-1])) == ordered:
        return []
    return [f"images in the order of all numbers in their names: first {ordered[0].name}, last {ordered[-1].name}"]


def _constant_shift(left: Mapping[_Key, Path], right: Mapping[_Key, Path]) -> int:
    """Constant by which the right files' numbers are larger than the left ones', if both count without a gap."""
    if len(left) != len(right) or any(len(key) > 1 for key in (*left, *right)):
        return 0
    first, last = ([int(of(side)[0]) for side in (left, right)] for of in (min, max))
    gapless = all(end - begin == len(left) - 1 for begin, end in zip(first, last, strict=True))
    return first[1] - first[0] if gapless and len(left) > 1 else 0


def _stamps(keys: Sequence[_Key]) -> tuple[float, ...]:
    """Times [s] by names that begin with a Unix time, perhaps followed by its fraction; empty for others."""
    unit = unix_unit(keys[0][0])
    if not unit:
        return ()
    fractions = [key[1] if unit == 1 and len(key) > 1 else Decimal(0) for key in keys]
    finest = next(n for n in (10**3, 10**6, 10**9) if max(fractions) < n or n == 10**9)
    return tuple(float(key[0] / unit + part / finest) for key, part in zip(keys, fractions, strict=True))


def _by_stamp(ordered: Sequence[Sequence[Path]], stamps: Sequence[Sequence[float]]) -> FilePairs:
    """Pairs by the nearest time."""
    left, right = ordered
    nearest = nearest_pairs(np.array(stamps[0]), np.array(stamps[1]), 1e3, str(left[0].parent))
    note = f"paired by time stamps, {nearest.apart:.3g} ms apart"
    if alone := len(left) + len(right) - 2 * len(nearest.left):
        note += f"; {alone} images have no partner"
    pairs = _in_order([left[k] for k in nearest.left], [right[k] for k in nearest.right])
    return pairs._replace(times=tuple(stamps[0][k] for k in nearest.left), notes=(note,))


class NearestPairs(NamedTuple):
    """Left and right images that belong together, as indices, and the median of the time between them."""

    left: NDArray[np.intp]
    right: NDArray[np.intp]
    apart: float  # [ms]


def nearest_pairs(left: NDArray[Any], right: NDArray[Any], to_ms: float, source: str) -> NearestPairs:
    """To each left image the nearest right one, within half a period.

    Args:
        left: stamps (n,) of the left images, two or more; they increase.
        right: stamps (m,) of the right ones.
        to_ms: milliseconds in a unit of the stamps.
        source: of the images, for the error.

    Raises:
        ValueError: one line, if less than half of the left images have a right one.
    """
    period = float(np.median(np.diff(left)))
    after = np.clip(np.searchsorted(right, left), 1, right.size - 1)
    near = np.where(left - right[after - 1] <= right[after] - left, after - 1, after)
    apart = np.abs(right[near] - left)
    good = apart < _NEAR * period
    _, first = np.unique(np.where(good, near, -1 - np.arange(left.size)), return_index=True)
    kept = np.sort(first)
    kept = kept[good[kept]]
    typical = to_ms * float(np.median(apart))
    if kept.size < max(2.0, _PAIRED * left.size):
        raise ValueError(
            f"{source}: only {kept.size} of {left.size} left images have a right one within half a period: the nearest "
            f"are {typical:.0f} ms apart; the cameras must be triggered together"
        )
    return NearestPairs(kept, near[kept], typical)


_LONGEST_PERIOD = 10.0  # between frames [s]; longer ones mean another unit, or no visible motion
_LATEST = 1e10  # time stamp [s]: 300 years
_EARLIEST: Final = 10**8  # Unix time: 1973 [s]
_UNITS: Final = {1: "s", 1_000: "ms", 1_000_000: "us", 1_000_000_000: "ns"}  # of Unix times, by number in a second


class FrameTimes(NamedTuple):
    """Times of frames, oldest first."""

    times: tuple[float, ...]  # [s]
    notes: tuple[str, ...] = ()


def read_times(path: Path) -> FrameTimes:
    """Times [s] that increase by at least a tick.

    Raises:
        ValueError: one line naming file, line and remedy.
    """
    if not os.path.lexists(path):
        raise ValueError(f"{path} is missing: create it with the time [s] of every frame, or use --rate HZ")
    lines = read_text(path, FileKind.TABLE).splitlines()
    if len(lines) > MAX_FRAMES:
        raise ValueError(f"{path} has {len(lines)} lines: a recording must have at most {MAX_FRAMES} frames")
    numbered = ((k, line.strip()) for k, line in enumerate(lines, start=1))
    kept = [(k, line) for k, line in numbered if line and not line.startswith("#")]
    if kept and not re.search(r"\d", kept[0][1]):  # names of the columns
        kept = kept[1:]
    commas = _decimal_commas([line for _, line in kept])
    rows = [(k, line.replace(",", "." if commas else " ").split()) for k, line in kept]
    column, notes = _column([row for _, row in rows])
    values = [_value(path, k, row, column) for k, row in rows]
    unit = unix_unit(min((value for _, value in values), default=0)) or 1
    times = [(k, value / unit) for k, value in values]
    if unit > 1:
        notes = (*notes, f"{path.name}: times are in {_UNITS[unit]}")
    _check(path, times)
    return FrameTimes(tuple(time for _, time in times), notes)


def _decimal_commas(lines: Sequence[str]) -> bool:
    """True for single numbers with a comma as decimal sign: what stands before it does not count the frames."""
    parts = [re.fullmatch(r"(\d+),\d+", line) for line in lines]
    before = [int(part[1]) for part in parts if part]
    return len(before) == len(lines) and any(after <= one for one, after in pairwise(before))


def unix_unit(time: float | Decimal) -> int:
    """Number of the unit of a Unix time in a second; 0 if it is none, or before 1973."""
    return max((n for n in _UNITS if time >= _EARLIEST * n), default=0)


def _column(rows: Sequence[list[str]]) -> tuple[int, tuple[str, ...]]:
    """Column of the times: the second if the first one counts the frames."""
    counted = [row[0].isdecimal() and len(row) > 1 for row in rows]
    if len(rows) < 2 or not all(counted):
        return 0, ()
    numbers = [int(row[0]) for row in rows]
    steps = {after - before for before, after in pairwise(numbers)}
    try:
        second = [float(row[1]) for row in rows]
    except ValueError:  # file names
        return 0, ()
    if steps == {1} and all(after > before for before, after in pairwise(second)):
        return 1, ("times are in the second column; the first one counts the frames",)
    return 0, ("times are in the first column; the second one has other numbers",)


def _value(path: Path, number: int, row: list[str], column: int) -> tuple[int, float]:
    """Number of the line and its time, in the table's unit; date and time count as UTC."""
    text = row[column] if column < len(row) else ""
    try:
        value: float = int(text) if text.isdecimal() else float(text)
    except ValueError:
        try:
            value = _date(" ".join(row[:2]) if len(row) > 1 and "T" not in text else text)
        except ValueError:
            raise ValueError(
                f"{path}, line {number}: '{shown(' '.join(row), 40)}' is not a time [s]. Repair it or use --rate HZ"
            ) from None
    if not abs(value) <= _LATEST * max(_UNITS):
        raise ValueError(f"{path}, line {number}: {value} is not a time [s]. Repair it or use --rate HZ")
    return number, value


def _date(text: str) -> float:
    """Seconds since 1970 of a date and time such as 2011-09-26 13:02:25.964389445, or with a time zone."""
    date = datetime.fromisoformat(text)
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _check(path: Path, times: Sequence[tuple[int, float]]) -> None:
    """Refuse times that do not rise, or that can not be seconds."""
    for (_, before), (k, after) in pairwise(times):
        if after - before < 0.999 * TICK:
            raise ValueError(
                f"{path}, line {k}: {after:.15g} s must be at least {TICK:g} s after the line before. "
                "Repair it or use --rate HZ"
            )
    period = float(np.median(np.diff([time for _, time in times]))) if len(times) > 1 else 0.0
    if period > _LONGEST_PERIOD:
        raise ValueError(
            f"{path}: {period:g} s between frames is more than {_LONGEST_PERIOD:g} s. Times must be in seconds: are "
            "these milliseconds? Or use --rate HZ"
        )
