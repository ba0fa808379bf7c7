"""What a run collects is whole and in order, wherever it is kept."""

from __future__ import annotations

import copy
import pickle
import sys
from functools import partial

import numpy as np
import pytest

from scenarios.loop.kept import Kept


@pytest.mark.parametrize("count", [0, 1, 9, 10, 19, 20, 21, 57])
def test_a_kept_sequence_is_a_list(count: int) -> None:
    """Length, order, places from both ends and slices, with 10 items in a chunk."""
    items = [(k, str(k)) for k in range(count)]
    kept = Kept(10, items)
    assert list(kept) == items
    assert len(kept) == count
    assert [kept[k] for k in range(-count, count)] == items + items
    assert kept[3:-2] == items[3:-2]
    with pytest.raises(IndexError):
        kept[count]
    assert list(pickle.loads(pickle.dumps(kept))) == items


@pytest.mark.parametrize("count", [7, 39, 40, 41, 57])
def test_recent_items_stay_in_memory(count: int) -> None:
    """The 20 newest at least, and at most two chunks of 10 more; copies and pickles keep to it."""
    kept = Kept(10, range(count), recent=20)
    assert list(kept) == list(range(count))
    assert min(count, 20) <= len(kept._newest) < 40
    for other in (copy.deepcopy(kept), pickle.loads(pickle.dumps(kept))):
        other.append(count)
        assert list(other) == list(range(count + 1))
        assert other._recent == 20


def test_copies_go_on_by_themselves() -> None:
    """They share what is in the file, and write behind each other."""
    one = Kept(5, range(23))
    other = copy.deepcopy(one)
    one.append(-1)
    for k in range(100, 120):
        other.append(k)
        one.append(-k)
    assert list(other) == [*range(23), *range(100, 120)]
    assert list(one) == [*range(23), -1, *range(-100, -120, -1)]


def test_arrays_come_back_bit_by_bit() -> None:
    rows = np.random.default_rng(1).normal(size=(50, 3))
    rows[7, 1] = np.nan
    assert np.array(list(Kept(4, rows))).tobytes() == rows.tobytes()


def test_items_that_can_not_be_pickled_stay() -> None:
    """A class of the user's own may hold anything."""
    functions = [partial(lambda k: k, k) for k in range(30)]
    assert [function() for function in Kept(4, functions)] == list(range(30))


def test_only_the_newest_are_in_memory() -> None:
    """Of 400 arrays of 80 kB at most 20 are; all of them would be 32 MB."""
    kept = Kept[np.ndarray](10)
    for k in range(400):
        kept.append(np.full(10_000, float(k)))
    in_memory = sum(sys.getsizeof(item) for item in kept._newest)
    assert in_memory < 2e6
    assert not any(isinstance(chunk, list) for chunk in kept._older)
    assert kept[123][0] == 123.0
