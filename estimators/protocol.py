"""Interface of every estimator."""

from __future__ import annotations

from typing import Protocol, TypeVar

Memory = TypeVar("Memory")
MessageT_contra = TypeVar("MessageT_contra", contravariant=True)
EstimateT_co = TypeVar("EstimateT_co", covariant=True)


class Estimator(Protocol[Memory, MessageT_contra, EstimateT_co]):
    """Recursive estimator without hidden state: everything it remembers is in the memory passed in and returned."""

    def init(self) -> Memory:
        """Memory before the first message."""

    def step(self, memory: Memory, message: MessageT_contra, /) -> tuple[Memory, EstimateT_co | None]:
        """Memory after the message, and the estimate at its tick if there is a new one."""
