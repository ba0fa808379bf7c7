"""The soak notices what grows, and its cheapest parts in short."""

import threading
from pathlib import Path

import pytest

from tests.soak.measure import Soaked, Usage, soaked, usage
from tests.soak.parts import PARTS


@pytest.mark.slow
def test_growth_of_memory_descriptors_and_threads_is_noticed() -> None:
    kept: list[object] = []
    stop = threading.Event()
    try:
        leak = soaked(lambda: kept.append(bytearray(b"x") * 4_000_000), usage(), 8)
        assert "memory grows" in (leak.wrong(0.5) or "")
        leak = soaked(lambda: kept.append(Path(__file__).open()), usage(), 4)  # noqa: SIM115  # left open on purpose
        assert "2 more descriptors" in (leak.wrong(0.5) or "")
        leak = soaked(lambda: threading.Thread(target=stop.wait).start(), usage(), 4)
        assert "2 more threads" in (leak.wrong(0.5) or "")
    finally:
        stop.set()
        for thing in kept:
            if hasattr(thing, "close"):
                thing.close()


def test_what_is_kept_once_is_no_growth() -> None:
    start, warm = Usage(100.0, 5, 1, 0), Usage(300.0, 9, 4, 1)
    assert Soaked(start, warm, warm, 10).wrong(0.1) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["driving environment", "refusals"])
def test_short_soak(name: str, tmp_path: Path) -> None:
    part = next(part for part in PARTS if part.name == name)
    with part.opened(tmp_path) as cycle:
        assert soaked(cycle, usage(), 6).wrong(1.0) is None
