"""Pairs of image files by their names, read as the numbers in them.

Numbers that are the same in all names of a camera, as an image size or a date, say nothing.
"""

import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from offtrack.exchange.recordings.layouts.frame_times import unix_unit

_Key: TypeAlias = tuple[Decimal, ...]
_NEAR: Final = 0.5  # of the time between frames; images farther apart are no pair
_APART: Final = 1.0  # time between the images of a pair that is noted [ms]
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
    pairs = _in_order([left[k] for k in nearest.left], [right[k] for k in nearest.right])
    return pairs._replace(times=tuple(stamps[0][k] for k in nearest.left), notes=nearest.notes)


class NearestPairs(NamedTuple):
    """Left and right images that belong together, as indices in the order of time."""

    left: NDArray[np.intp]
    right: NDArray[np.intp]
    notes: tuple[str, ...]  # on images without a partner, and those a millisecond apart


def nearest_pairs(left: NDArray[Any], right: NDArray[Any], to_ms: float, source: str) -> NearestPairs:
    """To each left image the nearest right one, within half a period; of images with one stamp the first counts.

    Args:
        left: stamps (n,) of the left images.
        right: stamps (m,) of the right ones.
        to_ms: milliseconds in a unit of the stamps.
        source: of the images, for the error.

    Raises:
        ValueError: one line, if there are less than two, or less than half of the left images have a right one.
    """
    (one, of_one), (other, of_other) = (np.unique(side, return_index=True) for side in (left, right))
    for name, own in (("left", one), ("right", other)):
        if own.size < 2:
            raise ValueError(f"{source}: {own.size} images of the {name} camera; at least 2 are needed")
    period = float(np.median(np.diff(one)))
    after = np.clip(np.searchsorted(other, one), 1, other.size - 1)
    near = np.where(one - other[after - 1] <= other[after] - one, after - 1, after)
    apart = np.abs(other[near] - one)
    good = apart < _NEAR * period
    _, first = np.unique(np.where(good, near, -1 - np.arange(one.size)), return_index=True)
    kept = np.sort(first)
    kept = kept[good[kept]]
    typical = to_ms * float(np.median(apart))
    if kept.size < max(2.0, _PAIRED * one.size):
        raise ValueError(
            f"{source}: only {kept.size} of {one.size} left images have a right one within half a period: the nearest "
            f"are {typical:.0f} ms apart; the cameras must be triggered together"
        )
    alone = left.size + right.size - 2 * kept.size
    notes = [f"paired by time stamps, {typical:.3g} ms apart"] * (typical >= _APART)
    notes += [f"{alone} images have no partner"] * (alone > 0)
    return NearestPairs(of_one[kept], of_other[near[kept]], ("; ".join(notes),) if notes else ())
