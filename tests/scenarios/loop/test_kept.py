"""What a run collects is whole and in order, wherever it is kept."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import ClassVar, cast

import numpy as np
import pytest

from offtrack.exchange.recordings.writers import RoverRecordingWriter
from scenarios.loop.channel import InLine, Kept, Stopwatch
from scenarios.loop.image_observers import TracePictures
from sensors.messages import RoverView
from tests.vehicle.rovers import HOME, plant_on
from vehicle.rover.truth import RoverTruth


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
    assert not any(isinstance(chunk, list) for chunk in kept._older)
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


class Asking:
    """An item that is read by another thread while it is being written to the file."""

    kept: ClassVar["Kept[Asking]"] = Kept(2)
    read: ClassVar["list[Asking]"] = []

    def __reduce__(self) -> tuple[object, ...]:
        with ThreadPoolExecutor() as threads:
            self.read.append(threads.submit(self.kept.__getitem__, 3).result(timeout=10.0))
        return (Asking, ())


def test_a_thread_reads_while_another_one_appends() -> None:
    """The renderer's thread asks for a truth while the loop's thread writes older ones to the file."""
    items = [Asking() for _ in range(4)]
    for item in items:
        Asking.kept.append(item)
    assert Asking.read == [items[3], items[3]]


def test_arrays_come_back_bit_by_bit_and_what_can_not_be_pickled_stays() -> None:
    rows = np.random.default_rng(1).normal(size=(50, 3))
    rows[7, 1] = np.nan
    assert np.array(list(Kept(4, rows))).tobytes() == rows.tobytes()
    functions = [partial(lambda k: k, k) for k in range(30)]
    assert [function() for function in Kept(4, functions)] == list(range(30))


class Views:
    def __init__(self) -> None:
        self.added: list[tuple[int, float]] = []

    def add(self, view: RoverView, truth: RoverTruth) -> None:
        self.added.append((view.tick, float(truth.pose[0])))


def test_an_old_image_is_recorded_with_the_truth_at_its_capture() -> None:
    """A frozen image may be a minute old; of 1200 truths at most 600 are in memory. An image of no step is an error."""
    views = Views()
    plant = plant_on(None)
    truth = plant.observe(plant.initial_state(HOME), 0)
    view = RoverView(
        tick=0, image=np.zeros((1, 1), dtype=np.uint8), heading=0.0, wheel_speeds=np.zeros(4), steer=np.zeros(4)
    )
    pictures = TracePictures(None, InLine(), Stopwatch(), keep=False, recorder=cast("RoverRecordingWriter", views))
    for tick in range(0, 60_000, 50):
        pictures.follow(replace(truth, tick=tick, pose=np.array([1e-3 * tick, 0.0, 0.0])))
    ticks = (59_950, 59_900, 0, 3050)
    for tick in ticks:
        pictures.see(0, replace(view, tick=tick), truth)
    assert views.added == [(tick, 1e-3 * tick) for tick in ticks]
    assert len(pictures._truths._newest) <= 600
    with pytest.raises(KeyError):
        pictures.see(0, replace(view, tick=3051), truth)
