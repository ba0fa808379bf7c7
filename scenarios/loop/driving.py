"""Interface of the tractor's driver."""

from __future__ import annotations

from typing import Protocol, TypeVar

from controllers.driver import DriverCommand
from sensors.messages import EgoState

MemoryT = TypeVar("MemoryT")


class Driver(Protocol[MemoryT]):
    """A driver of the tractor: pure, memory in and memory out."""

    def init(self) -> MemoryT:
        """Memory before the first step."""

    def step(self, memory: MemoryT, tick: int, ego: EgoState, /) -> tuple[MemoryT, DriverCommand]:
        """New memory and command at ``tick``."""
