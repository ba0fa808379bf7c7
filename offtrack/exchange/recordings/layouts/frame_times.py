"""Times of frames: tables of them, and which line of a table is which frame's.

A table has one line per frame: a time, or the frame's number and then its time (DSO), or a time and a file name (TUM,
EuRoC), or date and time (KITTI raw). Unix times may be in seconds, milliseconds, microseconds or nanoseconds.
"""

import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from offtrack.exchange.recordings.stereo_sequence import FrameFiles
from vehicle.clock import TICK
from vehicle.foundation.user_file import MAX_FRAMES, FileKind, read_text, shown

_PAUSE: Final = 1.0  # time between frames that is noted [s]
_LONGEST_PERIOD = 10.0  # between frames [s]; longer ones mean another unit, or no visible motion
_LATEST = 1e10  # time stamp [s]: 300 years
_EARLIEST: Final = 10**8  # Unix time: 1973 [s]
_UNITS: Final = {1: "s", 1_000: "ms", 1_000_000: "us", 1_000_000_000: "ns"}  # of Unix times, by number in a second


class FrameTimes(NamedTuple):
    """Times of frames, oldest first."""

    times: tuple[float, ...]  # [s]
    notes: tuple[str, ...] = ()


class TimedFrames(NamedTuple):
    """Frames by their numbers, which belong to lines of a table of times from the first one on, counted from 0."""

    keys: tuple[int, ...]
    first_line: int
    notes: tuple[str, ...] = ()


def timed_frames(
    keys: Sequence[int], lines: int, table: Path, notes: tuple[str, ...] = (), *, numbered: bool
) -> TimedFrames:
    """Assign lines of a table, on which there are ``notes``, to frames, where there is only one sensible way.

    Raises:
        ValueError: one line, if there is none.
    """
    every = tuple(range(keys[0], keys[-1] + 1))
    if lines == len(every):
        return TimedFrames(every, 0, notes)
    if lines == len(keys):
        return TimedFrames(tuple(keys), 0, notes)
    if numbered and lines > keys[-1]:  # images of a part, times of the whole sequence
        note = f"times.txt has {lines} lines, {lines - len(every)} of them without images"
        return TimedFrames(every, keys[0], (*notes, note))
    if lines == len(every) - 1 > 0:
        note = f"the last frame has no line in times.txt and is omitted: {keys[-1]}"
        return TimedFrames(every[:-1], 0, (*notes, note))
    raise ValueError(
        f"{table} has {lines} lines for {len(keys)} frames; it needs one line per frame. Repair it or use --rate HZ"
    )


def pause_notes(frames: Sequence[FrameFiles]) -> list[str]:
    """A note on the longest time between two frames, if it stands out."""
    steps = np.diff([files.time for files in frames])
    if not len(steps) or steps.max() < max(_PAUSE, 10.0 * float(np.median(steps))):
        return []
    return [f"no images for {steps.max():.1f} s after {frames[int(steps.argmax())].left.name}: are the times right?"]


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
    counted = [int(row[0]) for _, row in rows if len(row) == 1 and re.fullmatch(r"\d{1,8}", row[0])]
    if len(counted) == len(rows) > 2 and all(after - before == 1 for before, after in pairwise(counted)):
        raise ValueError(f"{path} counts the frames from {counted[0]} on: it needs their times [s], or use --rate HZ")
    column, notes = _column([row for _, row in rows])
    values = [_value(path, k, row, column) for k, row in rows]
    unit = unix_unit(min(values, default=0)) or 1
    times = [value / unit for value in values]
    if unit > 1:
        notes = (*notes, f"{path.name}: times are in {_UNITS[unit]}")
    for (before, after), (k, _) in zip(pairwise(times), rows[1:], strict=True):
        if after - before < 0.999 * TICK:
            line = f"{path}, line {k}: {after:.15g} s must be at least {TICK:g} s after the line before"
            raise ValueError(f"{line}. Repair it or use --rate HZ")
    period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if period > _LONGEST_PERIOD:
        raise ValueError(
            f"{path}: {period:g} s between frames is more than {_LONGEST_PERIOD:g} s. Times must be in seconds: are "
            "these milliseconds? Or use --rate HZ"
        )
    return FrameTimes(tuple(times), notes)


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


def _value(path: Path, number: int, row: list[str], column: int) -> float:
    """Time in a line of this number, in the table's unit; date and time count as UTC."""
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
    return value


def _date(text: str) -> float:
    """Seconds since 1970 of a date and time such as 2011-09-26 13:02:25.964389445, or with a time zone."""
    date = datetime.fromisoformat(text)
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
