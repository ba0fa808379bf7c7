"""The cache of a user: shared by processes, bounded, and only files that can be trusted are read."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vehicle.foundation import user_cache
from vehicle.foundation.user_cache import made_once, store, warn_once
from vehicle.frames import FloatArray


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OFFTRACK_CACHE", str(tmp_path / "cache"))
    warn_once.cache_clear()
    made.clear()
    return tmp_path / "cache"


made: list[int] = []


def noise(rng: np.random.Generator, n: int) -> FloatArray:
    made.append(n)
    return rng.standard_normal(n)


def cached_noise(seed: int, n: int = 3, sources: str = "now") -> FloatArray:
    return made_once(noise, sources, rng=np.random.default_rng(seed), n=n)


def test_the_same_inputs_and_sources_are_made_once(folder: Path) -> None:
    """State of a random generator, arguments and sources decide; what is read is bitwise what was made."""
    for seed, n, sources in (
        (1, 3, "now"),
        (1, 3, "now"),
        (2, 3, "now"),
        (1, 4, "now"),
        (1, 3, "later"),
        (1, 4, "now"),
    ):
        assert np.array_equal(cached_noise(seed, n, sources), np.random.default_rng(seed).standard_normal(n))
    assert made == [3, 3, 4, 3]
    assert len(list(folder.iterdir())) == 4


def test_what_other_code_decides_is_not_cached(folder: Path) -> None:
    """Inputs of a class from elsewhere, whose sources may change, and all without known sources."""

    class Own(int):
        """A class of the user."""

    for _ in range(2):
        made_once(noise, "now", rng=np.random.default_rng(1), n=Own(3))
        cached_noise(1, sources="")
    assert len(made) == 4
    assert not folder.exists()


def test_the_entries_used_longest_ago_make_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(user_cache, "_LARGEST", 5_000)
    for name in ("a", "b", "c"):
        store(f"{name}.entry", bytes(1_500))
    for name, age in (("a", 1), ("b", 3), ("c", 2)):
        os.utime(folder / f"{name}.entry", (1e9 - age, 2e9))
    assert user_cache.cached("b.entry") == bytes(1_500)  # used now
    store("d.entry", bytes(1_500))
    assert {path.stem for path in folder.iterdir()} == {"a", "b", "d"}


SCRIPT = """
import numpy as np
from vehicle.foundation.user_cache import made_once
for seed in range(20):
    made = made_once(np.arange, "now", stop=200_000 + seed, dtype=None)
    assert made[-1] == 200_000 + seed - 1
print("whole")
"""


def test_two_processes_at_once_read_whole_entries(folder: Path) -> None:
    """Both make, read and replace the same entries."""
    processes = [subprocess.Popen([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert [process.communicate()[0] for process in processes] == ["whole\n", "whole\n"]
    assert all(path.suffix == ".pickle" for path in folder.iterdir())
