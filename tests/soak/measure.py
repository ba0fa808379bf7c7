"""Memory, descriptors, threads and children of this process, and the judgement of their growth."""

import ctypes
import gc
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

_SLACK: Final = 4.0  # growth of memory in all that tells nothing: the allocator's own [MB]


class Usage(NamedTuple):
    memory: float  # resident [MB]
    descriptors: int
    threads: int
    children: int

    def __str__(self) -> str:
        memory, *counts = self
        return f"{memory:7.1f} MB, {counts[0]} descriptors, {counts[1]} threads, {counts[2]} children"


def usage() -> Usage:
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    tasks = os.listdir("/proc/self/task")
    children = [child for task in tasks for child in Path(f"/proc/self/task/{task}/children").read_text().split()]
    return Usage(
        memory=pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
        descriptors=len(os.listdir("/proc/self/fd")) - 1,  # the listing's own
        threads=max(len(tasks), threading.active_count()),
        children=len(children),
    )


class Soaked(NamedTuple):
    """Usage before a part, after its first half, which warms up, and at its end."""

    before: Usage
    middle: Usage
    after: Usage
    cycles: int  # between the middle and the end

    def wrong(self, megabytes: float) -> str | None:
        """Growth in the second half, in one line; None if nothing has grown."""
        grown = self.after.memory - self.middle.memory
        if grown > _SLACK + megabytes * self.cycles:
            return f"memory grows by {grown / self.cycles:.2f} MB per cycle, limit {megabytes:g} MB"
        for name in ("descriptors", "threads", "children"):
            if (more := getattr(self.after, name) - getattr(self.middle, name)) > 0:
                return f"{more} more {name} after {self.cycles} cycles"
        return None


def soaked(cycle: Callable[[], object], before: Usage, cycles: int) -> Soaked:
    """Repeat ``cycle``: half of the cycles warm up, the other half is judged."""
    for _ in range(cycles - cycles // 2):
        cycle()
    middle = usage()
    for _ in range(cycles // 2):
        cycle()
    return Soaked(before, middle, usage(), max(1, cycles // 2))
